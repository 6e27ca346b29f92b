"""Moving-horizon estimation of game parameters with an arrival cost.

Each update fits the game to the last `window` observations. Everything before the window enters as
an arrival cost (module `arrival_cost`). Module `update_phases` has the phases of updates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.annotations import no_type_check
from foresight_env.equilibrium.checks.validation import check_kinds
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.settings import Budget, SolverOptions
from foresight_env.equilibrium.solve import Solution
from foresight_env.games.game import Game, inside_bounds
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.arrival_cost import Belief, ProcessNoise, carried_belief
from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.current_state import corrected
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.initial import NeverSeenError, guess_initial_state
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.result import Estimate
from foresight_env.inverse.settings import UpdateSettings
from foresight_env.inverse.update_phases import TRANSITIONS, UpdateEvent, UpdatePhase
from foresight_env.inverse.window_fit import WindowFit, moved_along, rates_of

ONE_GAME = GaussNewton(max_iterations=0, smoothing=(), tracking_weights=())
"""Method of updates that solve a single game."""


def smoothed_options(variance: float, settings: UpdateSettings = UpdateSettings()) -> SolverOptions:
    """Return solver options whose game is smoothed by less than the noise of this variance.

    A complementarity product moves what rests on a bound by about as much, and spares a fit most of
    its refused steps.
    """
    barrier = float(np.clip(variance, settings.least_smoothing, settings.most_smoothing))
    plain = SolverOptions()
    tolerance = max(plain.tolerance, plain.path.smoothed_tolerance * barrier)
    return SolverOptions(tolerance=tolerance, barrier=barrier)


class MovingHorizonState(NamedTuple):
    """State of the estimator."""

    observations: tuple[Float[np.ndarray, "size"], ...]
    beliefs: tuple[Belief, ...]
    """Beliefs of the last updates, oldest first."""
    estimate: Estimate | None
    """The last estimate that could be used; its stage 1 is the window's first observation."""
    initial_guess: Solution | None
    """Solution that the next update continues from."""
    theta: tuple[Theta, ...]
    gamma: Float[np.ndarray, "N"]
    first_theta: tuple[Theta, ...]
    """As given to `init`: the centre of the first prior."""
    total: int
    """Observations so far."""
    failures: int
    """Updates without a usable fit, which kept the previous estimate."""
    reduced_chi_squared: float = 1.0
    """Unexplained variance of the last fit relative to the noise, at least 1. Covariances of the
    estimate are to be multiplied by it (Birge, Phys. Rev. 40, 1932)."""
    present: tuple[Float[np.ndarray, "_"], ...] | None = None
    """Every player's present state: the estimate's, corrected by the newest observation, the more
    the less the fit explains (`reduced_chi_squared`). Plans begin with it."""
    phase: UpdatePhase = UpdatePhase.WAITING
    """How the next update fits."""

    @property
    def gamma_deviation(self) -> Float[np.ndarray, "N"]:
        """Deviation of each discount factor, `reduced_chi_squared` included; NaN before any fit."""
        if self.estimate is None:
            return np.full(len(self.gamma), np.nan)
        return self.estimate.gamma_deviation * np.sqrt(self.reduced_chi_squared)

    @property
    def stage(self) -> int:
        """Index of the present in the estimate's trajectory (0 is the window's first stage)."""
        return len(self.observations) - 1

    def after(self, event: UpdateEvent) -> MovingHorizonState:
        """Return the state with the phase that follows an event."""
        return self._replace(phase=TRANSITIONS[self.phase, event])

    def __repr__(self) -> str:
        found = ", ".join(
            f"{value:.2f} +- {deviation:.2f}"
            for value, deviation in zip(self.gamma, self.gamma_deviation, strict=True)
        )
        return (
            f"MovingHorizonState({self.phase.value}, observations={self.total}, "
            f"failures={self.failures}, gamma=[{found}], "
            f"reduced_chi_squared={self.reduced_chi_squared:.2f})"
        )


@no_type_check
@dataclass(frozen=True, eq=False)
class MovingHorizonEstimator:
    """Moving-horizon estimator of game parameters; its state travels in `MovingHorizonState`.

    Each update fits the game to the last `window` observations; earlier ones enter through an
    arrival cost.

    Raises:
        ValueError: a field has the wrong type; the message names it.
    """

    game: Game
    """Its horizon is `window - 1` plus the stages to be predicted."""
    model: ObservationModel
    """Observation model of the joint state."""
    free: Free | Sequence[Free]
    """Parameters to estimate, for all players or per player; initial states must be free."""
    covariance: float
    """Variance of the noise of the newest observation."""
    window: int = 10
    """Observations that an update fits."""
    prior: Prior = Prior()
    """Of the parameters, before the first observation."""
    process_noise: ProcessNoise = ProcessNoise()
    """How fast parameters may change between observations."""
    forgetting_factor: float = 1.0
    """Growth of the noise deviation of an observation per step into the past. Above 1 where agents
    change their plans, so that old observations say less about them."""
    starts: int = 2
    """Discount factors to start from where there is no last solution."""
    budget: Budget = Budget.online()
    """Limits of each update. With `Budget.realtime()` an update solves one game."""
    options: SolverOptions | None = None
    """Of the forward solver; None: `smoothed_options` of the covariance."""
    method: GaussNewton = GaussNewton(
        max_iterations=8, cost_tolerance=1e-3, smoothing=(3e-2,), tracking_weights=()
    )
    """Of fits that take more than one game."""
    settings: UpdateSettings = UpdateSettings()
    """When updates look for another equilibrium, and how much their games are smoothed."""

    def __post_init__(self) -> None:
        check_kinds(
            game=(self.game, Game),
            model=(self.model, ObservationModel),
            free=(self.free, Free, tuple, list),
            prior=(self.prior, Prior),
            process_noise=(self.process_noise, ProcessNoise),
            budget=(self.budget, Budget),
            options=(self.options, SolverOptions, type(None)),
            method=(self.method, GaussNewton),
            settings=(self.settings, UpdateSettings),
        )

    def init(self, theta: Sequence[Theta], gamma: Any) -> MovingHorizonState:
        """Return the state before any observation.

        Args:
            theta: one mapping of cost parameters per player: fixed, or where fits begin.
            gamma: discount factors (N,) or one number: fixed, or where fits begin.

        Returns:
            The state for the first `update`.

        Raises:
            ValueError: an initial state is not free, the horizon is shorter than the window, or a
                discount factor is outside the range in which it is estimated.
        """
        count = len(self.game.players)
        each = (self.free,) * count if isinstance(self.free, Free) else self.free
        if len(each) != count:
            raise ValueError(f"free: expected a sequence of {count}, one Free per player, or one")
        if not all(f.initial_state for f in each):
            raise ValueError("free: an online estimator needs every player's initial state free")
        if self.game.horizon < self.window:
            raise ValueError(
                f"game: has horizon {self.game.horizon}; expected at least the window's "
                f"{self.window}"
            )
        discounts = np.broadcast_to(np.asarray(gamma, float), (count,)).copy()
        for i, (f, value) in enumerate(zip(each, discounts, strict=True)):
            low, high = f.gamma_range
            if f.gamma and not low <= value <= high:
                raise ValueError(
                    f"gamma[{i}]: starts at {value:g}; it is estimated in [{low:g}, {high:g}] "
                    "(free.gamma_range)"
                )
        return MovingHorizonState((), (), None, None, tuple(theta), discounts, tuple(theta), 0, 0)

    def update(
        self, state: MovingHorizonState, observation: Float[np.ndarray, "size"]
    ) -> MovingHorizonState:
        """Return the state after one observation.

        Args:
            state: of the last update, or of `init`.
            observation: (size,) of the observation model; NaN where missing.

        Returns:
            The state with a new estimate; where no fit succeeds, with the last one and one more
            of `failures`.

        Raises:
            ValueError: the observation has the wrong shape or is infinite.
        """
        if np.shape(observation) != (self.model.size,):
            raise ValueError(
                f"observation: has shape {np.shape(observation)}; expected ({self.model.size},), "
                "what the observation model returns (an environment's observation without its goal)"
            )
        if np.isinf(observation).any():
            raise ValueError(
                "observation: holds an infinite number; expected numbers, or NaN where missing"
            )
        sliding = len(state.observations) == self.window
        observations = (*state.observations, np.asarray(observation, float))[-self.window :]
        state = state._replace(observations=observations, total=state.total + 1)
        if len(observations) < 2:
            return state.after(UpdateEvent.NO_DATA)
        padded = np.full((self.window, self.model.size), np.nan)
        padded[: len(observations)] = np.stack(observations)
        if np.isnan(padded).all():
            return self._keep(state, sliding)
        try:
            initial = self._initial_state(state, sliding, padded)
        except NeverSeenError:  # wait for it
            return state._replace(failures=state.failures + 1)
        age = np.maximum(len(observations) - 1 - np.arange(self.window), 0)
        variance = self.covariance * self.forgetting_factor ** (2.0 * age)
        fits = WindowFit(
            self.game,
            self.model,
            self.free,
            self.options or smoothed_options(self.covariance, self.settings),
            padded,
            variance[:, None, None] * np.eye(self.model.size),
            self._prior(state),
            initial,
            state.theta,
            state.gamma,
        )
        last = None
        if state.estimate is not None and state.initial_guess is not None:
            last = moved_along(state.estimate, sliding)
        update = self._update_one_game if self.budget.single_game else self._update
        try:
            return update(state, fits, last, sliding)
        except NeverSeenError:  # out of sight for the whole window, and nothing is known before it
            return self._keep(state, sliding)

    def _update(
        self, state: MovingHorizonState, fits: WindowFit, last: Estimate | None, sliding: bool
    ) -> MovingHorizonState:
        """Take the better one of a fit from the last solution and one from the observations.

        A game may have several equilibria. The last one is where the present one is expected; where
        it no longer explains the observations, or never did well, they may come from another.
        """
        found, abandoned, spent = None, False, 0
        if last is not None and state.phase is UpdatePhase.TRACKING:
            limit = max(self.settings.plausible, state.reduced_chi_squared) * fits.freedom(last)
            most, own = self.budget.gauss_newton_steps, int(self.method.max_iterations)
            tracking = replace(
                self.method,
                max_iterations=own if most is None else min(own, most),
                initial_cost_limit=self.settings.abandoned * limit,
            )
            found = fits.run(tracking, self.budget, initial_guess=last.solution)
            abandoned = self.settings.abandoned * limit < fits.cost(found) < np.inf
            spent = 1
        doubted = found is None or self._doubts(state, fits.reduced_chi_squared(found))
        if doubted and spent < self.budget.fits:
            other = fits.run(self.method, self.budget, self.starts if last is None else 1)
            spent += 1
            nothing_better = abandoned and not fits.cost(other) < fits.cost(found)
            if last is not None and nothing_better and spent < self.budget.fits:
                other = fits.run(self.method, self.budget, initial_guess=last.solution)
            if fits.cost(other) < fits.cost(found):
                found = other
        return self._take(state, fits, found, sliding)

    def _doubts(self, state: MovingHorizonState, reduced_chi_squared: float) -> bool:
        rises = reduced_chi_squared > self.settings.worse * state.reduced_chi_squared
        due = rises or state.total % self.window == 0
        return reduced_chi_squared > self.settings.plausible and due

    def _update_one_game(
        self, state: MovingHorizonState, fits: WindowFit, last: Estimate | None, sliding: bool
    ) -> MovingHorizonState:
        """Solve one game: where a step on the last fit's derivatives leads, or from observations.

        Without a solution to continue from, it may take as long as it needs.
        """
        if last is not None and state.phase is UpdatePhase.TRACKING:
            found = fits.run(
                ONE_GAME, self.budget, initial_guess=last.solution, rates=rates_of(last)
            )
            quality = fits.reduced_chi_squared(found)
            if not np.isfinite(quality):
                missed = self._keep(state, sliding, UpdateEvent.MISSED)
                return missed._replace(initial_guess=last.solution)
            event = UpdateEvent.DOUBTED if self._doubts(state, quality) else UpdateEvent.FITTED
            return self._take(state, fits, found, sliding, event)
        limited = self.budget if last is not None else Budget.offline()
        found = fits.run(ONE_GAME, limited, 1 if last is not None else self.starts)
        quality = fits.reduced_chi_squared(found)
        if last is not None and state.reduced_chi_squared <= quality < np.inf:
            kept = self._keep(state, sliding, UpdateEvent.KEPT)
            return kept._replace(initial_guess=last.solution, failures=state.failures)
        return self._take(state, fits, found, sliding)

    def _take(
        self,
        state: MovingHorizonState,
        fits: WindowFit,
        found: Estimate | None,
        sliding: bool,
        event: UpdateEvent | None = None,
    ) -> MovingHorizonState:
        """Continue with a fit, or with the last one where it cannot be used."""
        quality = fits.reduced_chi_squared(found)
        if found is None or not np.isfinite(quality):
            return self._keep(state, sliding)
        belief = carried_belief(
            found, len(state.observations), state.total, quality, self.process_noise
        )
        early = not self.budget.single_game and state.total <= self.settings.initial_updates
        usual = UpdateEvent.FITTED_EARLY if early else UpdateEvent.FITTED
        return state.after(event or usual)._replace(
            estimate=found,
            initial_guess=found.solution,
            theta=found.theta,
            gamma=found.gamma,
            beliefs=self._remember(state, belief),
            reduced_chi_squared=quality,
            present=self._present(state, found, quality - 1.0),
        )

    def _keep(
        self, state: MovingHorizonState, sliding: bool, event: UpdateEvent = UpdateEvent.FAILED
    ) -> MovingHorizonState:
        """Keep the old estimate, moved along when the window has moved."""
        state = state.after(event)._replace(initial_guess=None, failures=state.failures + 1)
        if state.estimate is None:
            return state
        old = moved_along(state.estimate, sliding)
        belief = carried_belief(
            old,
            len(state.observations),
            state.total,
            state.reduced_chi_squared,
            self.process_noise,
        )
        return state._replace(
            estimate=old,
            beliefs=self._remember(state, belief),
            # The newest observation is not in it, and its variance grows.
            present=self._present(
                state, old, state.reduced_chi_squared, self.process_noise.state**2
            ),
        )

    def _present(
        self, state: MovingHorizonState, found: Estimate, inflation: float, widening: float = 0.0
    ) -> tuple[Float[np.ndarray, "_"], ...]:
        rates = found.state_jacobian[state.stage]
        excess = inflation * rates @ found.covariance @ rates.T + widening * np.eye(len(rates))
        now = np.concatenate([s[state.stage] for s in found.solution.states])
        newest = state.observations[-1]
        layout = layout_of(self.game)
        states = corrected(layout, self.model, now, excess, newest, self.covariance)
        return inside_bounds(self.game, states)

    def _remember(self, state: MovingHorizonState, belief: Belief) -> tuple[Belief, ...]:
        """Beliefs that later windows may begin with."""
        start = state.total - len(state.observations)
        return (*(b for b in state.beliefs if b.stage > start), belief)

    def _initial_state(
        self, state: MovingHorizonState, sliding: bool, padded: Float[np.ndarray, "W size"]
    ) -> tuple[Float[np.ndarray, "_"], ...]:
        if state.estimate is None:
            return guess_initial_state(self.game, self.model, padded)
        moved = state.estimate.solution.states
        return inside_bounds(self.game, [np.asarray(s[1 if sliding else 0]) for s in moved])

    def _prior(self, state: MovingHorizonState) -> Prior:
        """The arrival cost once the window has moved: the belief about its first stage."""
        start = state.total - len(state.observations)
        belief = next((b for b in state.beliefs if b.stage == start), None)
        if belief is None:
            return replace(self.prior, theta_center=state.first_theta)
        return belief.prior
