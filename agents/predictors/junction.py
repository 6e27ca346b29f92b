"""The realistic game as a predictor: inferred discount factors, preferred motion and routes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from agents.predictors.encounter_fit import preferred_motion, seen_states
from agents.predictors.equilibrium_forecast import (
    LEAST_STEPS,
    equilibrium_forecast,
    from_where_seen,
    straight_on,
    wandering,
)
from agents.predictors.kinematic import TURNING_SPEED
from foresight_env.datasets import Route, ahead_of, routes_at
from foresight_env.games import full_state
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse import Estimate, Free, MultiStart, Prior, estimate, guess_initial_state
from foresight_env.scenarios.realistic import (
    MOST_CURVATURE,
    DrivingWeights,
    PreferredMotion,
    WalkingWeights,
    driver_theta,
    realistic_game,
    walker_theta,
)

BEHIND, AHEAD = 10.0, 60.0
"""Part of a route that a driver sees, m from its last place."""
ROUTE_SPACING = 2
"""Every n-th point of a learned route is kept: `path_offset` averages over 1.5 m."""
OBSERVED = 4
"""Entries of a state that are observed: `[px, py, vx, vy]`, of vehicles `[px, py, v, psi]`."""
GAMMA_RANGE = (0.1, 1.0)
"""Of inferred discount factors per second: with less, what is two seconds ahead would count for
less than a hundredth."""
GENTLE = 3.0
"""Greatest acceleration of a guessed initial state, m/s^2."""
INSIDE = 0.8
"""Part of the largest curvature that a guessed initial state may have: the solver starts inside."""


class Noise(NamedTuple):
    """Standard deviations of the latest observations."""

    position: float = 0.1
    """Of vehicles, m."""
    speed: float = 0.007
    """Of vehicles, m/s: recordings are filtered, so speeds change smoothly."""
    heading: float = 0.0025
    """Of vehicles, rad."""
    walking: float = 0.1
    """Of people's positions and velocities, m and m/s."""
    forgetting_factor: float = 15.6
    """By how much all of them grow per second into the past: people change their minds."""


class RealisticBelief(NamedTuple):
    """Prior of the realistic game's parameters, and how agents depart from its equilibrium.

    Chosen on the development recordings of `evaluation.windows.interaction`.
    """

    speed_deviation: float = 4.0
    """Of drivers' preferred speeds about the last observed one, m/s."""
    curvature_deviation: float = 0.15
    """Of the curvatures that they settle at about the last observed one, 1/m."""
    velocity_deviation: float = 0.3
    """Of people's preferred velocities, m/s."""
    driving_gamma: tuple[float, float] = (0.5, 25.0)
    """Centre and weight of the prior of drivers' discount factors per second."""
    walking_gamma: tuple[float, float] = (0.9, 25.0)
    """And of people's."""
    driving_wander: float = 0.4
    """Density of the white acceleration by which vehicles depart from it, m^2/s^3."""
    walking_wander: float = 0.02
    """And of people."""


@dataclass(frozen=True)
class JunctionPredictor:
    """Fit of the realistic game to the history; its equilibrium is the forecast."""

    infer: bool = True
    """Whether discount factors are inferred; else they are 1."""
    noise: Noise = Noise()
    belief: RealisticBelief = RealisticBelief()
    driving: DrivingWeights = DrivingWeights()
    walking: WalkingWeights = WalkingWeights()
    starts: int = 2

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return "junction-game" if self.infer else "junction-game-gamma-1"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; constant velocity as a fallback where no fit succeeds.

        A single observation is nothing to fit to.
        """
        if len(history.states) < LEAST_STEPS:
            return straight_on(history, steps)
        return self.forecast(history, steps, self.fit(history, steps))

    def forecast(self, history: History, steps: int, found: Estimate) -> Forecast:
        """Return the forecast that a fit (`fit`) of the same history and steps makes."""
        departures = wandering(
            self.belief.walking_wander, self.belief.driving_wander, history, steps
        )
        forecast = equilibrium_forecast(found, history, steps, departures)
        return from_where_seen(forecast, found, history)

    def fit(self, history: History, steps: int) -> Estimate:
        """The estimate behind the forecast: it covers the history and `steps` more."""
        known = len(history.states)
        seen = seen_states(history)
        preferred = [_preferred(history, seen, i) for i in range(len(history.kinds))]
        routed = tuple(isinstance(p, PreferredMotion) and p.path is not None for p in preferred)
        game = realistic_game(history.kinds, routed, known - 1 + steps, history.dt)
        observations = seen.reshape(known, -1)
        model = full_state((OBSERVED,) * len(history.kinds))
        initial = guess_initial_state(game, model, observations)
        beliefs = [
            self.belief.driving_gamma if is_vehicle(kind) else self.belief.walking_gamma
            for kind in history.kinds
        ]
        return estimate(
            game,
            observations,
            model,
            initial_state=[
                _with_changes(state, seen[:, i], history) if is_vehicle(kind) else state
                for i, (state, kind) in enumerate(zip(initial, history.kinds, strict=True))
            ],
            theta=[
                driver_theta(p, self.driving)
                if isinstance(p, PreferredMotion)
                else walker_theta(p, self.walking)
                for p in preferred
            ],
            gamma=[center if self.infer else 1.0 for center, _ in beliefs],
            free=[self._free(kind, on) for kind, on in zip(history.kinds, routed, strict=True)],
            covariance=self._covariance(history),
            prior=Prior(
                tuple(weight for _, weight in beliefs),
                tuple(center for center, _ in beliefs),
                self._deviations(history.kinds, routed),
            ),
            starts=MultiStart(self.starts),
        )

    def _free(self, kind: str, routed: bool) -> Free:
        names: tuple[str, ...] = ("velocity",)
        if is_vehicle(kind):
            names = ("speed",) if routed else ("speed", "curvature")
        return Free(names, self.infer, True, GAMMA_RANGE)

    def _covariance(self, history: History) -> Float[np.ndarray, "K size size"]:
        """Covariance per observation, newest last."""
        noise = self.noise
        driving = (noise.position, noise.position, noise.speed, noise.heading)
        latest = np.concatenate(
            [driving if is_vehicle(k) else (noise.walking,) * OBSERVED for k in history.kinds]
        )
        age = history.dt * np.arange(len(history.states) - 1, -1, -1)
        deviation = noise.forgetting_factor ** age[:, None] * latest
        return deviation[:, :, None] ** 2 * np.eye(len(latest))

    def _deviations(
        self, kinds: tuple[str, ...], routed: tuple[bool, ...]
    ) -> tuple[tuple[str, float], ...]:
        """Deviations of preferred motion, of the kinds of agents that there are."""
        driving = [is_vehicle(kind) for kind in kinds]
        found = []
        if not all(driving):
            found.append(("velocity", self.belief.velocity_deviation))
        if any(driving):
            found.append(("speed", self.belief.speed_deviation))
        if any(drives and not on for drives, on in zip(driving, routed, strict=True)):
            found.append(("curvature", self.belief.curvature_deviation))
        return tuple(found)


def _preferred(history: History, seen: Float[np.ndarray, "K N 4"], agent: int) -> Any:
    """Preferred motion: a driver's `PreferredMotion`, a person's velocity (2,)."""
    preferred = preferred_motion(history, agent)
    if not is_vehicle(history.kinds[agent]):
        return preferred
    speed, curvature = preferred
    state = seen[history.seen(agent)[-1], agent]
    anchor = np.array([state[0], state[1], state[3]])
    begin = int(history.seen(agent)[-1]) + 1
    return PreferredMotion(speed, anchor, curvature, _route(history, state), begin)


def _route(history: History, state: Float[np.ndarray, "4"]) -> Float[np.ndarray, "M 4"] | None:
    """The most frequent route that a vehicle may be on, moved sideways to where it is."""
    if state[2] < TURNING_SPEED:
        return None
    context = history.context
    known = [Route(p, float(n)) for p, n in zip(context.routes, context.frequencies, strict=True)]
    possible = routes_at(known, state[:2], float(state[3]))
    if not possible:
        return None
    route = max(possible, key=lambda r: r.frequency)
    path = ahead_of(route, state[:2], BEHIND, AHEAD)[::ROUTE_SPACING].copy()
    nearest = path[np.argmin(np.hypot(*(path[:, :2] - state[:2]).T))]
    left = np.array([-np.sin(nearest[2]), np.cos(nearest[2])])
    offset = float(left @ (state[:2] - nearest[:2]))
    path[:, 0] -= offset * np.sin(path[:, 2])
    path[:, 1] += offset * np.cos(path[:, 2])
    return path


def _with_changes(
    state: Float[np.ndarray, "6"], seen: Float[np.ndarray, "K 4"], history: History
) -> Float[np.ndarray, "6"]:
    """A guessed initial state with the acceleration and curvature of the first two observations."""
    rows = np.flatnonzero(~np.isnan(seen[:, 0]))[:2]
    if len(rows) < 2:
        return state
    change = (seen[rows[1], 2:] - seen[rows[0], 2:]) / (history.dt * float(rows[1] - rows[0]))
    curvature = change[1] / max(float(seen[rows[0], 2]), TURNING_SPEED)
    guessed = state.copy()
    guessed[4] = np.clip(change[0], -GENTLE, GENTLE)
    guessed[5] = np.clip(curvature, -INSIDE * MOST_CURVATURE, INSIDE * MOST_CURVATURE)
    return guessed
