"""Arrival cost of the moving-horizon estimator: the posterior of observations before the window.

It is the posterior of the fit that ended with the observation before the window's first, its state
carried to the window's first stage and widened by `ProcessNoise`. No observation counts twice, and
parameters may change (Rao, Rawlings and Lee, "Constrained linear state estimation -- a moving
horizon approach", Automatica 37, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.inverse.parameter import Parameter
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.result import Estimate

LEAST_SPECTRUM = 1e-13
"""Least variance of a belief that counts, relative to its largest: after outliers a covariance has
a condition number at which an inverse is not positive definite any more. A numerical guard,
some hundred times the rounding of float64; `benchmarks.robustness` uses such estimators."""


class ProcessNoise(NamedTuple):
    """Standard deviations by which beliefs widen over one window; `benchmarks.online` measures."""

    gamma: float = 0.2
    theta: float = 0.3
    """In each parameter's own unit (goals: m)."""
    state: float = 0.1
    """Of every state entry: how well the game describes agents (m, m/s)."""

    def of(self, parameters: Sequence[Parameter]) -> Float[np.ndarray, "p"]:
        """Return the deviation of each parameter."""
        kinds = {"gamma": self.gamma, "initial_state": self.state, "theta": self.theta}
        return np.array([kinds[parameter.kind] for parameter in parameters])


class Belief(NamedTuple):
    """Gaussian over the free parameters, initial states carried to the stage after their window."""

    stage: int
    """Which stage that is, counted from the first observation."""
    mean: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    widening: Float[np.ndarray, "p"]
    """Standard deviations that `ProcessNoise` adds until it is used."""

    @property
    def prior(self) -> Prior:
        """The belief as the prior of a window that begins at its stage.

        It contains the first prior already, which is not counted again.
        """
        covariance = self.covariance + np.diag(self.widening**2)
        spectrum, basis = np.linalg.eigh(0.5 * (covariance + covariance.T))
        spectrum = np.maximum(spectrum, LEAST_SPECTRUM * spectrum[-1])
        information = (basis / spectrum) @ basis.T
        return Prior(gamma_weight=0.0, mean=self.mean, information=information)


def is_initial_state(parameters: Sequence[Parameter]) -> np.ndarray:
    """(p,) which parameters are entries of initial states."""
    return np.array([parameter.kind == "initial_state" for parameter in parameters])


def carried_belief(
    found: Estimate, ahead: int, stage: int, reduced_chi_squared: float, noise: ProcessNoise
) -> Belief:
    """Return an estimate's posterior with its initial states carried `ahead` stages."""
    is_state = is_initial_state(found.parameters)
    carry = np.eye(len(is_state))
    carry[is_state] = found.state_jacobian[ahead]
    mean = found.values.copy()
    mean[is_state] = np.concatenate([s[ahead] for s in found.solution.states])
    covariance = reduced_chi_squared * carry @ found.covariance @ carry.T
    return Belief(stage, mean, covariance, noise.of(found.parameters))
