"""Initial guess of the state from the first observations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from foresight_env.games.arc import arc
from foresight_env.games.dynamics import Vehicle
from foresight_env.games.game import Game
from foresight_env.games.motion import planar_velocity
from foresight_env.games.observations import ObservationModel


class NeverSeenError(ValueError):
    """An agent has no observation."""


def guess_initial_state(
    game: Game, model: ObservationModel, observations: Float[np.ndarray, "K size"]
) -> tuple[Float[np.ndarray, "_"], ...]:
    """Return a guess of every player's `x_1`, to start an estimate from.

    Entries that are not observed come from the positions: velocities (double integrator) or speed
    and heading (vehicle) by the mean displacement over the first half of the window. An agent
    observed late is moved back along its velocity, a vehicle whose heading is observed along its
    circle.

    Args:
        game: the game that is played.
        model: the observation model; observed are the leading entries of each player's state.
        observations: (K, size); NaN where missing.

    Returns:
        Per-player states (n_i,), inside the state bounds.

    Raises:
        NeverSeenError: an agent has no observation.
    """
    owners = np.array([-1 if o is None else o for o in model.owners])
    states = []
    for i, player in enumerate(game.players):
        mine = observations[:, owners == i]
        seen = np.flatnonzero(~np.isnan(mine).any(axis=1)) if mine.shape[1] >= 2 else np.array([])
        if seen.size == 0:
            raise NeverSeenError(
                f"observations: player {i} was never observed; leave it out of the game"
            )
        first = int(seen[0])
        state = np.zeros(player.dynamics.state_size)
        width = min(mine.shape[1], state.size)
        state[:width] = mine[first, :width]
        last = int(seen[min(len(seen) - 1, max(1, len(seen) // 2))])
        if state.size >= 4:
            velocity = planar_velocity(player.dynamics, state)
            if width == 2 and last > first:
                velocity = (mine[last, :2] - mine[first, :2]) / (game.dt * (last - first))
                if isinstance(player.dynamics, Vehicle):
                    state[2:4] = np.hypot(*velocity), np.arctan2(velocity[1], velocity[0])
                else:
                    state[2:4] = velocity
            turn = 0.0
            if isinstance(player.dynamics, Vehicle) and width > 3 and last > first:
                turn = float((mine[last, 3] - mine[first, 3]) / (game.dt * (last - first)))
                state[3] -= game.dt * first * turn
            state[:2] -= arc(velocity, -turn, np.array([game.dt * first]))[0]
        if player.state_bounds is not None:
            state = np.clip(state, player.state_bounds.lower[0], player.state_bounds.upper[0])
        states.append(state)
    return tuple(states)
