"""Kinematic predictors: constant velocity, turn rate, acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History, single
from foresight_env.games.arc import arc
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.motion import driving_states

TURNING_SPEED = 0.5
"""Below this a vehicle's turn rate says nothing of its path, m/s."""
TURN_SECONDS = 0.8
"""Latest time that turn rates and accelerations are taken from; at least two rows."""


def recent_rows(history: History, agent: int) -> np.ndarray:
    """The rows of the latest `TURN_SECONDS` in which an agent was seen, two of them if it was."""
    rows = history.seen(agent)
    steps = max(1, round(TURN_SECONDS / history.dt))
    return np.unique(np.concatenate([rows[-2:], rows[rows >= rows[-1] - steps]]))


def turn_rate(history: History, agent: int) -> float:
    """Change of a vehicle's heading per second over its latest rows; 0 while it stands."""
    rows = recent_rows(history, agent)
    if len(rows) < 2 or np.hypot(*history.states[rows[-1], agent, 2:]) < TURNING_SPEED:
        return 0.0
    headings = driving_states(history.states[:, agent], history.headings[:, agent])[rows, 3]
    return float((headings[-1] - headings[0]) / (history.dt * (rows[-1] - rows[0])))


@dataclass(frozen=True)
class ConstantVelocityPredictor:
    """Straight motion with the last observed velocity (Schoeller et al., RA-L 2020)."""

    name: str = "constant-velocity"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        return single(_circles(history, steps, np.zeros(len(history.kinds))))


@dataclass(frozen=True)
class ConstantTurnRatePredictor:
    """Vehicles keep speed and turn rate (CTRV; Schubert, Richter, Wanielik, FUSION 2008).

    People go straight on: their turn rate over a second says nothing of the next ones.
    """

    name: str = "constant-turn-rate"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        turns = [
            turn_rate(history, i) if is_vehicle(kind) else 0.0
            for i, kind in enumerate(history.kinds)
        ]
        return single(_circles(history, steps, np.array(turns)))


NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Of Gauss and Legendre's rule on [-1, 1]: exact to rounding for turns of a few radians."""


@dataclass(frozen=True)
class ConstantTurnRateAccelerationPredictor:
    """Vehicles keep their turn rate and their acceleration until they stand (CTRA).

    Schubert, Richter, Wanielik, FUSION 2008, section II-B. People go straight on.
    """

    name: str = "constant-acceleration"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        paths = []
        for i, kind in enumerate(history.kinds):
            rows = history.seen(i)
            state = history.states[rows[-1], i]
            age = len(history.states) - 1 - rows[-1]
            times = history.dt * (age + np.arange(1, steps + 1))
            turn, rate = 0.0, 0.0
            if is_vehicle(kind):
                turn, rate = turn_rate(history, i), acceleration(history, i)
            paths.append(state[:2] + _changing_arc(state[2:], turn, rate, times))
        return single(np.stack(paths, axis=1))


def acceleration(history: History, agent: int) -> float:
    """Change of an agent's speed per second over its latest rows, m/s^2."""
    rows = recent_rows(history, agent)
    if len(rows) < 2:
        return 0.0
    speeds = np.hypot(*history.states[rows, agent, 2:].T)
    return float((speeds[-1] - speeds[0]) / (history.dt * (rows[-1] - rows[0])))


def _changing_arc(
    velocity: Float[np.ndarray, "2"], turn: float, rate: float, times: Float[np.ndarray, "P"]
) -> Float[np.ndarray, "P 2"]:
    """Displacements at `times` (s) of a motion whose speed changes by `rate` until it stands."""
    speed = float(np.hypot(*velocity))
    if rate < 0.0:
        times = np.minimum(times, -speed / rate)
    heading = np.arctan2(velocity[1], velocity[0])
    moments = 0.5 * times[:, None] * (1.0 + NODES)
    speeds, headings = speed + rate * moments, heading + turn * moments
    passed = 0.5 * times[:, None] * WEIGHTS * speeds
    return np.stack([(passed * np.cos(headings)).sum(1), (passed * np.sin(headings)).sum(1)], 1)


def _circles(
    history: History, steps: int, turns: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "P N 2"]:
    """Agents on circles (lines where the turn rate is 0) from their last observed positions."""
    paths = []
    for i, turn in enumerate(turns):
        last = history.seen(i)[-1]
        state = history.states[last, i]
        age = len(history.states) - 1 - last
        times = history.dt * (age + np.arange(1, steps + 1))
        paths.append(state[:2] + arc(state[2:], float(turn), times))
    return np.stack(paths, axis=1)
