"""Others and sensors that an ego does not expect: they violate its model of the world.

A surprise changes the behaviour of the uncontrolled agents, or what the ego observes of them. It is
part of a `RunSetting`, and the same for all egos.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.predictors.social_force import SMALL, SUBSTEP, SocialForcePredictor
from foresight_env.envs.core.behaviours import (
    BehaviourFactory,
    BehaviourSetting,
    Receding,
    SolverReport,
)
from foresight_env.envs.core.motion import applicable
from foresight_env.equilibrium import Budget, Solution, Status, shift, solve
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)
from foresight_env.scenarios.crosswalk import COLLISION_DISTANCE
from foresight_env.scenarios.episode_parameters import EpisodeParameters

CHANGE_TIME = 1.0
"""Time at which discount factors change, s: agents are about to meet."""
LONG_SIGHT, SHORT_SIGHT = 0.95, 0.4
"""Discount factors after the change, of those that were below and above the middle of the two."""
EGO, IGNORING = 0, 1
"""The ego in the scenarios with these surprises, and the player that ignores all others."""
FAR = 1e3
"""Coordinates of an ignored agent, m."""
PACE = 0.8
"""Preferred speed of social-force walkers, m/s: the speed limit per axis at the crosswalk."""
ARRIVAL = 1.0
"""Time to the goal below which they slow down, s."""
BODY_RADIUS = 0.5 * COLLISION_DISTANCE
"""Of these walkers, m."""
DROPOUT = 0.3
"""Probability that another agent is not observed at a step."""
OUTLIER = 0.05
"""Probability that another agent's observed position is an outlier."""
OUTLIER_DEVIATIONS = 20.0
"""Standard deviation of an outlier, in those of the noise."""

Sensor = Callable[
    [np.random.Generator, Float[np.ndarray, "others width"], float], Float[np.ndarray, "others _"]
]
"""From a generator, what the ego observes of the others and the noise's standard deviation."""


class ChangingGamma(Receding):
    """Re-plans at every step; `CHANGE_TIME` after the start short-sighted agents see far, and
    far-sighted ones become short-sighted."""

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting)
        self._steps, self._change = 0, round(CHANGE_TIME / setting.game(1).dt)

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin an episode with the drawn discount factors."""
        super().reset(episode_parameters)
        self._steps = 0

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of the equilibrium with the present discount factors."""
        controls = super().act(states)
        self._steps += 1
        if self._steps == self._change and self._episode is not None:
            middle = 0.5 * (LONG_SIGHT + SHORT_SIGHT)
            gamma = np.where(self._episode.gamma < middle, LONG_SIGHT, SHORT_SIGHT)
            gamma[EGO] = self._episode.gamma[EGO]
            self._episode = self._episode._replace(gamma=gamma)
        return controls


class IgnoringOthers(Receding):
    """Re-plans at every step; the player `IGNORING` moves as if it were alone: it ignores all."""

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting)
        self._alone = best_response_game(self._game, IGNORING)
        self._own: Solution | None = None

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin an episode."""
        super().reset(episode_parameters)
        self._own = None

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of the equilibrium, and of the one player's problem without others."""
        controls = super().act(states)
        if self._episode is not None:
            controls[IGNORING] = self._alone_control(states, self._episode)
        return controls

    def _alone_control(
        self, states: Float[np.ndarray, "N n"], episode: EpisodeParameters
    ) -> Float[np.ndarray, "m"]:
        away = np.tile([FAR, FAR, 0.0, 0.0], (self._game.horizon, 1))
        others = {j: away for j in range(len(states)) if j != IGNORING}
        theta = best_response_parameters(self._game, IGNORING, episode.theta[IGNORING], others)
        guess = None if self._own is None else shift(self._own)
        found = solve(
            self._alone,
            [states[IGNORING]],
            [theta],
            [float(episode.gamma[IGNORING])],
            initial_guess=guess,
            budget=Budget.trial(),
        )
        self._own = found if int(found.status) == Status.SOLVED else guess
        if self._own is None:
            return np.zeros(self._game.players[IGNORING].dynamics.control_size)
        return np.asarray(self._own.controls[0][0])


class SocialForce:
    """Walkers of the social force model, each with its goal; they play no game."""

    report = SolverReport()
    planned: tuple[Float[np.ndarray, "K 2"], ...] | None = None

    def __init__(self, setting: BehaviourSetting) -> None:
        self._game = setting.game(setting.planning_horizon)
        self._model = SocialForcePredictor()
        self._goals = np.zeros((0, 2))

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin an episode."""
        self._goals = np.stack([np.asarray(own["goal"]) for own in episode_parameters.theta])

    def plan(self, states: Float[np.ndarray, "N n"]) -> None:
        """Return None: there is no plan."""

    def act(self, states: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 2"]:
        """Mean accelerations over a step of the model."""
        dt, model = self._game.dt, self._model
        parts = max(1, int(np.ceil(dt / SUBSTEP)))
        places, velocities = states[:, :2].copy(), states[:, 2:].copy()
        away = self._goals - places
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        # Evenly to the goal, more slowly near it.
        preferred = away * np.minimum(1.0 / ARRIVAL, PACE / np.maximum(distance, SMALL))
        bodies = [(2.0 * BODY_RADIUS, 2.0 * BODY_RADIUS)] * len(states)
        for _ in range(parts):
            push = np.stack([model.push(i, places, velocities, bodies) for i in range(len(states))])
            pull = (preferred - velocities) / model.relaxation
            velocities = velocities + dt / parts * (pull + push)
            places = places + dt / parts * velocities
        return applicable(self._game, states, (velocities - states[:, 2:]) / dt)


class Surprise(NamedTuple):
    """One kind of surprise."""

    scenarios: tuple[str, ...]
    """In which it can occur."""
    behaviour: str | BehaviourFactory = "receding"
    sensor: Sensor | None = None


def _dropouts(
    random: np.random.Generator, others: Float[np.ndarray, "others width"], noise_std: float
) -> Float[np.ndarray, "others width"]:
    found = others.copy()
    found[random.random(len(others)) < DROPOUT] = np.nan
    return found


def _outliers(
    random: np.random.Generator, others: Float[np.ndarray, "others width"], noise_std: float
) -> Float[np.ndarray, "others width"]:
    found = others.copy()
    away = random.normal(0.0, OUTLIER_DEVIATIONS * noise_std, (len(others), 2))
    found[:, :2] += np.where(random.random((len(others), 1)) < OUTLIER, away, 0.0)
    return found


ANYWHERE = ("crosswalk", "intersection", "driving", "recorded")
SURPRISES: dict[str, Surprise] = {
    "none": Surprise(ANYWHERE),
    "gamma-change": Surprise(("crosswalk", "driving"), ChangingGamma),
    "ignores-others": Surprise(("crosswalk", "driving"), IgnoringOthers),
    "social-force": Surprise(("crosswalk",), SocialForce),
    "idm": Surprise(("driving",), "idm"),
    "dropouts": Surprise(ANYWHERE, sensor=_dropouts),
    "outliers": Surprise(ANYWHERE, sensor=_outliers),
}
"""By name."""


def observed(
    surprise: str,
    random: np.random.Generator,
    observation: Float[np.ndarray, "size"],
    players: int,
    noise_std: float,
) -> Float[np.ndarray, "size"]:
    """Return the observation under a surprise; entries of the ego and its goal are unchanged."""
    sensor = SURPRISES[surprise].sensor
    if sensor is None:
        return observation
    found = np.array(observation)
    width = (len(found) - 2) // players
    others = found[width:-2].reshape(players - 1, width)
    found[width:-2] = sensor(random, others.astype(float), noise_std).ravel()
    return found
