"""Constant-velocity motion from recent observations: least squares over a short window."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from foresight_env.games import Dynamics, ObservationModel
from foresight_env.games.motion import moving_state, planar_velocity

FIT_STEPS = 5
"""Observations that the straight line is fitted through."""


def player_positions(
    model: ObservationModel, observations: Float[np.ndarray, "K size"], player: int
) -> Float[np.ndarray, "K 2"]:
    """One player's observed positions: the first two entries that it owns."""
    mine = [k for k, owner in enumerate(model.owners) if owner == player][:2]
    return observations[:, mine]


def fit_constant_velocity(
    track: Float[np.ndarray, "K 2"], dt: float
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Present position (m) and velocity (m/s) of a straight, even motion through `track`.

    Missing rows are NaN; with one row the agent rests. `ValueError` when no row was seen.
    """
    rows = np.flatnonzero(~np.isnan(track).any(axis=1))[-FIT_STEPS:]
    if rows.size == 0:
        raise ValueError("track: the agent was never seen")
    if rows.size == 1:
        return track[rows[0]].copy(), np.zeros(2)
    times = (rows - (len(track) - 1)) * dt
    velocity, position = np.polyfit(times, track[rows], 1)
    return position, velocity


def extrapolate(
    dynamics: Dynamics,
    state: Float[np.ndarray, "4"],
    steps: int,
    dt: float,
) -> Float[np.ndarray, "T 4"]:
    """States after 1..steps steps of straight, even motion."""
    times = dt * np.arange(1, steps + 1)[:, None]
    places = state[:2] + times * planar_velocity(dynamics, state)
    return np.concatenate([places, np.tile(state[2:], (steps, 1))], axis=1)


def present_state(
    dynamics: Dynamics,
    model: ObservationModel,
    observations: Float[np.ndarray, "K size"],
    player: int,
    dt: float,
) -> Float[np.ndarray, "4"]:
    """A player's state now (m, m/s, rad) by straight, even motion through its positions.

    Where one observation is all there is, and it shows the whole state, that is the state.
    """
    mine = [k for k, owner in enumerate(model.owners) if owner == player]
    own = observations[:, mine]
    whole = own[~np.isnan(own).any(axis=1)]
    if own.shape[1] > 3 and len(whole) == 1:
        return np.array(whole[0, :4])
    heading = float(whole[-1, 3]) if own.shape[1] > 3 and len(whole) else float("nan")
    return moving_state(dynamics, *fit_constant_velocity(own[:, :2], dt), heading)
