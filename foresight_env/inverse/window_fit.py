"""The inverse problem of one window of observations, of the moving-horizon estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foresight_env.equilibrium.settings import Budget, SolverOptions
from foresight_env.equilibrium.solve import Solution, shift
from foresight_env.equilibrium.status import Status
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.arrival_cost import is_initial_state
from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.estimate import estimate
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.linear_step import Rates
from foresight_env.inverse.multi_start import MultiStart
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.result import Estimate


@dataclass(frozen=True, eq=False)
class WindowFit:
    """Observations and prior of a window, and starts of its fits."""

    game: Game
    model: ObservationModel
    free: Free | Sequence[Free]
    options: SolverOptions
    observations: Float[np.ndarray, "W size"]
    """NaN where missing or yet to come."""
    covariance: Float[np.ndarray, "W size size"]
    prior: Prior
    initial_state: tuple[Float[np.ndarray, "_"], ...]
    theta: tuple[Theta, ...]
    gamma: Float[np.ndarray, "N"]

    def run(
        self,
        method: GaussNewton,
        budget: Budget,
        starts: int = 1,
        initial_guess: Solution | None = None,
        rates: Rates | None = None,
    ) -> Estimate:
        """Fit from a similar game's solution, or from the observations."""
        return estimate(
            self.game,
            self.observations,
            self.model,
            initial_state=self.initial_state,
            theta=self.theta,
            gamma=self.gamma,
            free=self.free,
            covariance=self.covariance,
            prior=self.prior,
            method=method,
            starts=MultiStart(starts),
            initial_guess=initial_guess,
            initial_guess_rates=rates,
            budget=budget,
            options=self.options,
        )

    def cost(self, found: Estimate | None) -> float:
        """The objective; infinite where a fit cannot be used."""
        if found is None or int(found.status) != Status.SOLVED:
            return np.inf
        return float(found.cost) if np.isfinite(found.covariance).all() else np.inf

    def freedom(self, found: Estimate) -> int:
        """Numbers observed beyond the parameters that they determine."""
        seen = int(np.sum(~np.isnan(self.observations)))
        return max(seen - len(found.parameters), seen // 4, 1)

    def reduced_chi_squared(self, found: Estimate | None) -> float:
        """Reduced chi-squared, at least 1; infinite where a fit cannot be used."""
        if found is None:
            return np.inf
        return max(1.0, self.cost(found) / self.freedom(found))


def moved_along(found: Estimate, sliding: bool) -> Estimate:
    """The estimate with its trajectory beginning a stage later, where the window slides.

    `values` and what is derived by them stay those of the window before.
    """
    if not sliding:
        return found
    moved = shift(found.solution)
    rates = found.state_jacobian
    return found._replace(
        solution=moved,
        initial_state=tuple(np.asarray(s[0]) for s in moved.states),
        state_jacobian=np.concatenate([rates[1:], rates[-1:]]),
    )


def rates_of(moved: Estimate) -> Rates:
    """How such an estimate changes with its `values`."""
    carry = np.eye(len(moved.parameters))
    is_state = is_initial_state(moved.parameters)
    carry[is_state] = moved.state_jacobian[0]
    return Rates(moved.state_jacobian, carry)
