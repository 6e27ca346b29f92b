"""Cost of a player at one stage, elastic penalties included."""

from __future__ import annotations

import jax.numpy as jnp

from foresight_env.games.costs import weight_value
from foresight_env.games.game import Game
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta


def stage_cost(
    game: Game, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
) -> tuple[Scalar, Scalar]:
    """Return player i's costs at stage t.

    Args:
        game: the game.
        i: the player.
        t: the stage, from 1.
        x: per-player states that the controls lead to.
        u: per-player controls.
        theta: the player's parameters.

    Returns:
        The sum of the costs that its discounting applies to, and of those that it does not.
    """
    player = game.players[i]
    discounted = jnp.zeros(())
    for cost in player.costs:
        discounted += cost(i, t, x, u, theta)
    for constraint in player.inequalities:
        if constraint.penalty is not None:
            violation = jnp.maximum(-constraint.function(i, t, x, u, theta), 0.0)
            discounted += weight_value(constraint.penalty, theta) * jnp.sum(violation)
    undiscounted = jnp.zeros(())
    for cost in player.undiscounted_costs:
        undiscounted += cost(i, t, x, u, theta)
    return discounted, undiscounted
