"""Result of an estimation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from foresight_env.equilibrium.solve import Solution
from foresight_env.equilibrium.status import Status
from foresight_env.games.types import Theta
from foresight_env.inverse.parameter import Parameter
from foresight_env.inverse.posterior import PosteriorMean


class Estimate(NamedTuple):
    """Estimated parameters, how certain they are, and the trajectory that they imply."""

    theta: tuple[Theta, ...]
    gamma: Float[np.ndarray, "N"]
    initial_state: tuple[Float[np.ndarray, "_"], ...]
    solution: Solution
    """The equilibrium at the estimate: the past explained, the rest of the horizon predicted."""
    cost: Float[np.ndarray, ""]
    """Value of the objective (paper, problem 1, prior included)."""
    parameters: tuple[Parameter, ...]
    """The p free parameters, in the order of `values` and `covariance`."""
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    """Laplace approximation: inverse of the Gauss-Newton information, prior included."""
    identifiable: Bool[np.ndarray, "p"]
    """False where the data leave a parameter open (`inverse.laplace.is_identifiable`); with a
    profile also discount factors whose interval is as wide as that of a uniform guess on their
    range."""
    state_jacobian: Float[np.ndarray, "stages n p"]
    """Derivative of the joint trajectory by the free parameters."""
    status: Int[np.ndarray, ""]
    """`Status.SOLVED` when some start found a fit whose game was solved."""
    num_forward_solves: Int[np.ndarray, ""]
    """All starts and the profile together."""
    num_newton_steps: Int[np.ndarray, ""]
    """Of the forward solve at the estimate."""
    start_costs: Float[np.ndarray, "S"]
    """Objective reached from each start; infinite where solves failed or the start was spared."""
    gamma_interval: Float[np.ndarray, "N 2"]
    """Intervals of the discount factors: at the level of the profile or the posterior that
    `estimate` was given, else 90 % by the Laplace approximation, within the limits; of width 0
    where fixed."""
    mean: PosteriorMean | None = None
    """Averages over the posterior; None without one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, such as `goal[0] of 1`, `gamma of 0`."""
        return tuple(str(parameter) for parameter in self.parameters)

    @property
    def deviation(self) -> Float[np.ndarray, "p"]:
        """Standard deviation of each free parameter."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def state_deviation(self) -> tuple[Float[np.ndarray, "stages _"], ...]:
        """Standard deviation of the trajectory that `covariance` implies, per player."""
        rates = self.state_jacobian
        variance = np.einsum("tnp,pq,tnq->tn", rates, self.covariance, rates)
        ends = np.cumsum([s.shape[1] for s in self.solution.states])[:-1]
        return tuple(np.split(np.sqrt(np.maximum(variance, 0.0)), ends, axis=1))

    @property
    def gamma_deviation(self) -> Float[np.ndarray, "N"]:
        """Standard deviation of each discount factor; 0 where it is fixed."""
        return self._per_player(self.deviation, np.zeros(len(self.gamma)))

    @property
    def gamma_identifiable(self) -> Bool[np.ndarray, "N"]:
        """Whether the data identify each discount factor; True where it is fixed."""
        return self._per_player(self.identifiable, np.ones(len(self.gamma), dtype=bool))

    def _per_player(self, values: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """Entries of the discount factors among `values`, `fixed` elsewhere."""
        for parameter, value in zip(self.parameters, values, strict=True):
            if parameter.kind == "gamma":
                fixed[parameter.player] = value
        return fixed

    def __repr__(self) -> str:
        found = ", ".join(
            f"{value:.2f} +- {deviation:.2f}"
            for value, deviation in zip(self.gamma, self.gamma_deviation, strict=True)
        )
        return (
            f"Estimate({Status(int(self.status)).name}, cost={float(self.cost):.3g}, "
            f"gamma=[{found}], parameters={len(self.parameters)}, "
            f"forward solves={int(self.num_forward_solves)}, solution={self.solution!r})"
        )
