"""Motion of an agent in the plane from its state, for all dynamics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from foresight_env.games.dynamics import Dynamics, Vehicle


def planar_velocity(dynamics: Dynamics, state: Float[np.ndarray, "_"]) -> Float[np.ndarray, "2"]:
    """Velocity (m/s) of `[px, py, vx, vy, ...]` or, of a vehicle, `[px, py, v, psi, ...]`."""
    if isinstance(dynamics, Vehicle):
        return np.asarray(state[2] * np.array([np.cos(state[3]), np.sin(state[3])]))
    return np.asarray(state[2:4])


def moving_state(
    dynamics: Dynamics,
    position: Float[np.ndarray, "2"],
    velocity: Float[np.ndarray, "2"],
    heading: float = np.nan,
) -> Float[np.ndarray, "4"]:
    """The state of that motion; a vehicle that stands has `heading` (rad), 0 where it is NaN.

    Of two headings that differ by whole turns the one nearer to `heading` is taken.
    """
    if dynamics.state_size != 4:
        raise ValueError(
            f"dynamics: {type(dynamics).__name__} has {dynamics.state_size} states; expected one "
            "with 4, which a position and a velocity determine"
        )
    if not isinstance(dynamics, Vehicle):
        return np.concatenate([position, velocity])
    speed = float(np.hypot(*velocity))
    own = float(np.arctan2(velocity[1], velocity[0]))
    if not np.isnan(heading):
        turns = np.round((heading - own) / (2.0 * np.pi))
        own = heading if speed < STANDING else own + 2.0 * np.pi * turns
    return np.array([*position, speed, own])


STANDING = 0.2
"""Below this a vehicle's velocity says nothing of its heading, m/s."""


def driving_state(state: Float[np.ndarray, "4"], heading: float = np.nan) -> Float[np.ndarray, "4"]:
    """`[px, py, vx, vy]` as a car's `[px, py, v, psi]` (m, m/s, rad).

    The heading is that of the velocity where none is given.
    """
    velocity = state[2:]
    own = np.arctan2(velocity[1], velocity[0]) if np.isnan(heading) else heading
    return np.array([*state[:2], np.hypot(*velocity), own])


def driving_states(
    states: Float[np.ndarray, "K 4"], headings: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K 4"]:
    """A recorded track `[px, py, vx, vy]` as a car's `[px, py, v, psi]`, headings without jumps.

    NaN where it was missing.
    """
    driven = np.full(states.shape, np.nan)
    seen = np.flatnonzero(~np.isnan(states[:, 0]))
    for k in seen:
        driven[k] = driving_state(states[k], float(headings[k]))
    driven[seen, 3] = np.unwrap(driven[seen, 3])
    return driven
