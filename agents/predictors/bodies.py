"""Sizes, positions and preferred velocities of the agents of a history."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import History
from agents.predictors.kinematic import turn_rate
from foresight_env.games.arc import arc
from foresight_env.games.kinds import is_vehicle, kind_of


def body_size(history: History, agent: int) -> tuple[float, float]:
    """Length and width, m; usual ones where the recording states none."""
    usual = kind_of(history.kinds[agent])
    extent = history.extents[agent]
    stated = np.where(extent > 0.0, extent, (usual.length, usual.width))
    return float(stated[0]), float(stated[1])


def body_radius(history: History, agent: int) -> float:
    """Radius of the disc that has the body's area, m."""
    length, width = body_size(history, agent)
    if is_vehicle(history.kinds[agent]):
        return float(np.sqrt(length * width / np.pi))
    return 0.5 * max(length, width)


def recent_turn(history: History, agent: int) -> float:
    """Turn rate (rad/s) that an agent keeps: a vehicle's latest one; people walk straight."""
    return turn_rate(history, agent) if is_vehicle(history.kinds[agent]) else 0.0


def wanted_velocities(
    history: History, count: int, dt: float
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "count N 2"]]:
    """Places now, and `count` velocities `dt` apart, from now on, that each agent would have alone.

    Who is out of sight now is where it would have gone to. Alone, people keep their velocity and
    vehicles their speed and turn rate.
    """
    places, wanted = [], []
    for agent in range(len(history.kinds)):
        last = history.seen(agent)[-1]
        state = history.states[last, agent]
        age = history.dt * (len(history.states) - 1 - last)
        turn = recent_turn(history, agent)
        places.append(state[:2] + arc(state[2:], turn, np.array([age]))[0])
        angles = turn * (age + dt * np.arange(count))
        left = np.array([-state[3], state[2]])
        wanted.append(np.cos(angles)[:, None] * state[2:] + np.sin(angles)[:, None] * left)
    return np.stack(places), np.stack(wanted, axis=1)
