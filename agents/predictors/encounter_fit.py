"""Common parts of the predictors that play the encounter game: priors and observed states."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import History
from agents.predictors.kinematic import turn_rate
from foresight_env.games.arc import arc
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.motion import driving_states
from foresight_env.scenarios.encounter import CURVATURE_LIMIT

LEAST_SPEED = 0.5
"""A slower vehicle's curvature is its turn rate over this speed, m/s."""


class EncounterBelief(NamedTuple):
    """Prior of people's and vehicles' parameters.

    Settings were chosen on the development recordings of `evaluation.windows.interaction`, those of
    discount factors in the manner of empirical Bayes.
    """

    velocity_deviation: float = 0.4
    """Of people's preferred velocities about the last observed one, m/s."""
    speed_deviation: float = 0.2
    """Of vehicles' preferred speeds, likewise."""
    curvature_deviation: float = 0.005
    """Of the preferred curvatures of their paths, 1/m."""
    walking_gamma: tuple[float, float] = (1.0, 64.0)
    """Centre and weight of the prior of people's discount factors."""
    driving_gamma: tuple[float, float] = (0.7, 16.0)
    """And of vehicles'."""
    walking_wander: float = 0.08
    """Density of the white acceleration by which people depart from the equilibrium, m^2/s^3."""
    driving_wander: float = 0.6
    """And vehicles."""

    def gamma(self, kind: str) -> tuple[float, float]:
        """Centre and weight of the prior of a discount factor."""
        return self.driving_gamma if is_vehicle(kind) else self.walking_gamma

    def gamma_deviation(self, kind: str) -> float:
        """Of that prior: a weight `w` on a square stands for a Gaussian of deviation `1/sqrt(w)`.

        Objectives here are sums of whitened squares, without the half (`inverse.Prior`).
        """
        return float(self.gamma(kind)[1] ** -0.5)

    def wish_deviation(self, kind: str) -> Float[np.ndarray, "2"]:
        """Of the entries of a preferred motion: a velocity, or speed and curvature."""
        if is_vehicle(kind):
            return np.array([self.speed_deviation, self.curvature_deviation])
        return np.array([self.velocity_deviation, self.velocity_deviation])


def preferred_motion(history: History, agent: int) -> Any:
    """Preferred motion of an agent: the last velocity, or the last speed and curvature."""
    velocity = history.states[history.seen(agent)[-1], agent, 2:]
    if not is_vehicle(history.kinds[agent]):
        return velocity
    speed = float(np.hypot(*velocity))
    curvature = turn_rate(history, agent) / max(speed, LEAST_SPEED)
    inside = 0.9 * CURVATURE_LIMIT
    return speed, float(np.clip(curvature, -inside, inside))


def seen_states(history: History) -> Float[np.ndarray, "K N 4"]:
    """States of the encounter game: of vehicles `[px, py, v, psi]`; NaN where unseen."""
    seen = np.array(history.states)
    for i, kind in enumerate(history.kinds):
        if is_vehicle(kind):
            seen[:, i] = driving_states(seen[:, i], history.headings[:, i])
    return seen


def filled_states(history: History) -> Float[np.ndarray, "K N 4"]:
    """`seen_states` without gaps: an agent out of sight keeps its speed and turn rate.

    From when it was seen last, or backwards from when it was seen first.
    """
    filled = seen_states(history)
    for i, kind in enumerate(history.kinds):
        rows = history.seen(i)
        for k in np.setdiff1d(np.arange(len(filled)), rows):
            row = int(max(rows[rows < k], default=rows[0]))
            seconds = history.dt * float(k - row)
            turn = turn_rate(history, i) if is_vehicle(kind) else 0.0
            filled[k, i] = filled[row, i]
            filled[k, i, :2] += arc(history.states[row, i, 2:], turn, np.array([seconds]))[0]
            if is_vehicle(kind):
                filled[k, i, 3] += turn * seconds
    return filled
