"""Estimation on the way: a window of recent observations and what earlier ones taught.

Each update fits the game to the last `window` observations. Everything before the window enters as
an arrival cost: the posterior of the fit that ended with the observation before the window's first,
its state carried to the window's first stage, widened by `ProcessNoise`. So no observation is counted
twice, and parameters may change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.interior_point import SolverOptions
from foresight_env.equilibrium.solve import Solution
from foresight_env.games.game import Game, inside_bounds
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.current_state import corrected
from foresight_env.inverse.estimate import Estimate
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.initial import NeverSeenError, guess_initial_state
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.window_fit import WindowFit, moved_along, rates_of

PLAUSIBLE = 1.5
"""`MovingHorizonState.reduced_chi_squared` up to which no other equilibrium is looked for: of 30 degrees of freedom,
noise alone leaves more once in twenty times."""
WORSE = 1.3
"""Rise of a larger reduced_chi_squared, as a ratio to the update before, after which one is; without a rise it
is looked for once per window."""

LEAST_SPECTRUM = 1e-13
"""Least variance that a belief counts, as a part of its largest."""
GIVE_UP = 4.0
"""Misfit of the first game of a fit from the last solution, as a ratio to the update before (or to
`PLAUSIBLE`, if that is larger), above which the fit ends: the shifted solution has led to another
equilibrium."""

ONE_GAME = GaussNewton(max_iterations=0, smoothing=(), hurried=True)
"""Of quick updates."""
ONE_GAME_STEPS = 40
"""Newton steps along the path that these get: of 434 left turns' updates 8 failed; with 25 steps
36, with 10 a third."""


def quick_options(variance: float) -> SolverOptions:
    """Forward-solver settings for fits that are wanted in time.

    The game is smoothed by less than the noise (a complementarity product moves what rests on a
    bound by about as much), which spares a fit most of its refused steps.
    """
    barrier = float(np.clip(variance, 1e-9, 1e-3))
    return SolverOptions(tolerance=max(1e-8, 1e-3 * barrier), barrier=barrier)


class ProcessNoise(NamedTuple):
    """Standard deviations by which beliefs widen over one window."""

    gamma: float = 0.2
    theta: float = 0.3
    """In each parameter's own unit (goals: m)."""
    state: float = 0.1
    """Of every state entry: how well the game describes what agents do (m, m/s)."""


class Belief(NamedTuple):
    """Gaussian over the free parameters, initial states moved to the stage after their window."""

    stage: int
    """Which stage that is, counted from the first observation."""
    mean: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    widening: Float[np.ndarray, "p"]
    """Standard deviations that `ProcessNoise` adds until it is used."""


class MovingHorizonState(NamedTuple):
    """What the estimator remembers."""

    observations: tuple[Float[np.ndarray, "size"], ...]
    beliefs: tuple[Belief, ...]
    """Beliefs of the last updates, oldest first."""
    estimate: Estimate | None
    """The last estimate that could be used; its stage 1 is the window's first observation."""
    initial_guess: Solution | None
    theta: tuple[Theta, ...]
    gamma: Float[np.ndarray, "N"]
    first_theta: tuple[Theta, ...]
    """What `init` was given: the centre of the first prior."""
    total: int
    """Observations so far."""
    failures: int
    """Updates that found no usable fit and kept the previous estimate."""
    reduced_chi_squared: float = 1.0
    """How much more than the noise the last fit leaves unexplained, as a ratio of variances, at
    least 1. Covariances of the estimate are to be multiplied by it (Birge, Phys. Rev. 40, 1932)."""
    present: tuple[Float[np.ndarray, "_"], ...] | None = None
    """Every player's state now: the estimate's, the more corrected by the newest observation the
    less the fit explains what was seen (`reduced_chi_squared`). What a plan is to begin with."""
    afresh: bool = False
    """Whether the next quick update looks for another equilibrium."""

    @property
    def gamma_deviation(self) -> Float[np.ndarray, "N"]:
        """Deviation of each discount factor, `reduced_chi_squared` included; NaN before any estimate."""
        if self.estimate is None:
            return np.full(len(self.gamma), np.nan)
        return self.estimate.gamma_deviation * np.sqrt(self.reduced_chi_squared)

    @property
    def stage(self) -> int:
        """Index of the present in the estimate's trajectory (0 is the window's first stage)."""
        return len(self.observations) - 1


@dataclass(frozen=True, eq=False)
class MovingHorizonEstimator:
    """Settings; all that changes travels in `MovingHorizonState`.

    `game` has the horizon `window - 1` plus what is to be predicted. `free` must free the initial
    states. The first updates, with little data, and those after a failure start afresh.
    """

    game: Game
    model: ObservationModel
    free: Free | Sequence[Free]
    covariance: float
    """Variance of the noise of the newest observation."""
    window: int = 10
    prior: Prior = Prior()
    process_noise: ProcessNoise = ProcessNoise()
    forgetting_factor: float = 1.0
    """How much the noise deviation of an observation grows per step into the past. Above 1 where
    agents change their plans, so that old observations say less of what they will do."""
    starts: int = 2
    """Discount factors to start from where there is no last solution."""
    careful_updates: int = 4
    """Updates at the beginning that start afresh."""
    warm_steps: int = 3
    """Most Gauss-Newton steps of a fit that goes on from the last one (others: the method's own
    limit). It need not converge, since the next update goes on where it ended (Diehl, Bock and
    Schloder, "A real-time iteration scheme for nonlinear optimization in optimal feedback control",
    SIAM J. Control Optim. 43, 2005)."""
    quick: bool = False
    """Whether each update solves one game alone, for estimates that are wanted in time: where a
    step on the last fit's derivatives leads (module `linear_step`), or, when the last fit left too
    much unexplained, from the observations. Then `careful_updates`, `warm_steps` and `method` have
    no say."""
    options: SolverOptions | None = None
    """Of the forward solver; None: `quick_options` of the covariance."""
    method: GaussNewton = GaussNewton(max_iterations=8, cost_tolerance=1e-3, smoothing=(3e-2,))

    def init(self, theta: Sequence[Theta], gamma: Any) -> MovingHorizonState:
        """Nothing seen yet; `theta` and `gamma` are fixed values or first guesses."""
        count = len(self.game.players)
        each = (self.free,) * count if isinstance(self.free, Free) else self.free
        if len(each) != count:
            raise ValueError(f"free: expected a sequence of {count}, one Free per player, or one")
        if not all(f.initial_state for f in each):
            raise ValueError("free: an online estimator needs every player's initial state free")
        if self.warm_steps < 1:
            raise ValueError(f"warm_steps: is {self.warm_steps}; expected at least 1")
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
        """Take one observation (NaN where missing); never worse than keeping the last estimate."""
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
            return state
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
            self.options or self._default_options(),
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
        if self.quick:
            return self._take_quickly(state, fits, last, sliding)
        return self._take(state, fits, self._searched(state, fits, last), sliding)

    def _default_options(self) -> SolverOptions:
        options = quick_options(self.covariance)
        return replace(options, trial_steps=ONE_GAME_STEPS) if self.quick else options

    def _searched(
        self, state: MovingHorizonState, fits: WindowFit, last: Estimate | None
    ) -> Estimate | None:
        """The better one of a fit that goes on and, where it is due, one that starts afresh."""
        # A game may have several equilibria. The last one is where the present one is expected;
        # where it explains the observations no longer, or never did well, they may speak for
        # another: both are fitted, the better fit wins. From where the last one leads far astray
        # it is not worth the time.
        found, given_up = None, False
        if last is not None and state.total >= self.careful_updates + 2:
            worst = GIVE_UP * max(PLAUSIBLE, state.reduced_chi_squared) * fits.freedom(last)
            brief = replace(self.method, max_iterations=self.warm_steps, give_up=worst)
            found = fits.run(brief, initial_guess=last.solution)
            given_up = worst < fits.cost(found) < np.inf
        if found is None or self._doubtful(state, fits.reduced_chi_squared(found)):
            other = fits.run(self.method, self.starts if last is None else 1)
            if last is not None and given_up and not fits.cost(other) < fits.cost(found):
                other = fits.run(
                    self.method, initial_guess=last.solution
                )  # there is nothing better
            if fits.cost(other) < fits.cost(found):
                found = other
        return found

    def _doubtful(self, state: MovingHorizonState, reduced_chi_squared: float) -> bool:
        rises = reduced_chi_squared > WORSE * state.reduced_chi_squared
        return reduced_chi_squared > PLAUSIBLE and (rises or state.total % self.window == 0)

    def _take_quickly(
        self, state: MovingHorizonState, fits: WindowFit, last: Estimate | None, sliding: bool
    ) -> MovingHorizonState:
        """One game's fit. A failure is followed by a fit afresh, two by one that takes its time."""
        if last is not None and not state.afresh:
            found = fits.run(ONE_GAME, initial_guess=last.solution, rates=rates_of(last))
            reduced_chi_squared = fits.reduced_chi_squared(found)
            following = self._take(state, fits, found, sliding)
            kept = None if np.isfinite(reduced_chi_squared) else last.solution
            afresh = self._doubtful(state, reduced_chi_squared)
            return following._replace(afresh=afresh, initial_guess=kept or following.initial_guess)
        state = state._replace(afresh=False)
        method = ONE_GAME if last is not None else replace(ONE_GAME, hurried=False)
        found = fits.run(method, 1 if last is not None else self.starts)
        reduced_chi_squared = fits.reduced_chi_squared(found)
        if last is not None and state.reduced_chi_squared <= reduced_chi_squared < np.inf:
            following = self._keep(state, sliding)
            return following._replace(initial_guess=last.solution, failures=state.failures)
        return self._take(state, fits, found, sliding)

    def _take(
        self, state: MovingHorizonState, fits: WindowFit, found: Estimate | None, sliding: bool
    ) -> MovingHorizonState:
        """Go on with a fit, or with the last one where it cannot be used."""
        reduced_chi_squared = fits.reduced_chi_squared(found)
        if found is None or not np.isfinite(reduced_chi_squared):
            return self._keep(state, sliding)
        belief = self._belief(found, len(state.observations), state.total, reduced_chi_squared)
        return state._replace(
            estimate=found,
            initial_guess=found.solution,
            theta=found.theta,
            gamma=found.gamma,
            beliefs=self._remember(state, belief),
            reduced_chi_squared=reduced_chi_squared,
            present=self._present(state, found, reduced_chi_squared - 1.0),
        )

    def _keep(self, state: MovingHorizonState, sliding: bool) -> MovingHorizonState:
        """The old estimate, moved along when the window has moved."""
        state = state._replace(initial_guess=None, failures=state.failures + 1)
        if state.estimate is None:
            return state
        old = moved_along(state.estimate, sliding)
        belief = self._belief(old, len(state.observations), state.total, state.reduced_chi_squared)
        return state._replace(
            estimate=old,
            beliefs=self._remember(state, belief),
            # The newest observation is not in it, and it is the less sure the older it is.
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
        """Beliefs that windows to come may begin with."""
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
        # By its spectrum: after outliers a covariance has a condition at which an inverse is not
        # positive any more.
        covariance = belief.covariance + np.diag(belief.widening**2)
        spectrum, basis = np.linalg.eigh(0.5 * (covariance + covariance.T))
        spectrum = np.maximum(spectrum, LEAST_SPECTRUM * spectrum[-1])
        information = (basis / spectrum) @ basis.T
        # The belief already contains the first prior; it is not counted again.
        return Prior(gamma_weight=0.0, mean=belief.mean, information=information)

    def _belief(
        self, found: Estimate, ahead: int, stage: int, reduced_chi_squared: float
    ) -> Belief:
        """The posterior with its initial states carried `ahead`, to the stage of that number."""
        is_state = np.array([name.startswith("initial_state[") for name in found.names])
        carry = np.eye(len(found.names))
        carry[is_state] = found.state_jacobian[ahead]
        mean = found.values.copy()
        mean[is_state] = np.concatenate([s[ahead] for s in found.solution.states])
        return Belief(
            stage,
            mean,
            reduced_chi_squared * carry @ found.covariance @ carry.T,
            self._widening(found.names),
        )

    def _widening(self, names: Sequence[str]) -> Float[np.ndarray, "p"]:
        kinds = {"gamma": self.process_noise.gamma, "initial_state": self.process_noise.state}
        return np.array(
            [kinds.get(n.split(" ")[0].split("[")[0], self.process_noise.theta) for n in names]
        )
