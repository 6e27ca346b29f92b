"""One step of the world: motion and stage costs as the scenario's game defines them."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games import (
    DoubleIntegrator,
    Dynamics,
    Game,
    ObservationModel,
    Vehicle,
    stage_cost,
)
from foresight_env.precision import in_double_precision

FIRST_STAGE = 1
"""Every step of the world is the first stage of the game that agents play from there on."""
RATES: dict[type, tuple[tuple[int, int], ...]] = {
    DoubleIntegrator: ((0, 2), (1, 3)),
    Vehicle: ((0, 2),),
}
"""Per kind of dynamics, which entry of the control is the rate of which entry of the state."""


def rates(dynamics: Dynamics) -> tuple[tuple[int, int], ...]:
    """Which entry of the control is the rate of which entry of the state."""
    for kind, found in RATES.items():
        if isinstance(dynamics, kind):
            return found
    raise ValueError(
        f"dynamics: is a {type(dynamics).__name__}; worlds move {[k.__name__ for k in RATES]}"
    )


def applicable(
    game: Game, states: Float[np.ndarray, "N n"], controls: Float[np.ndarray, "N m"]
) -> Float[np.ndarray, "N m"]:
    """`controls` reduced to the game's limits of controls and of the velocities they lead to."""
    applied = np.array(controls, dtype=float)
    for i, player in enumerate(game.players):
        if player.control_bounds is not None:
            low, high = player.control_bounds.lower[0], player.control_bounds.upper[0]
            applied[i] = np.clip(applied[i], low, high)
        if player.state_bounds is not None:
            low, high = player.state_bounds.lower[0], player.state_bounds.upper[0]
            for k, n in rates(player.dynamics):
                reach = (low[n] - states[i, n]) / game.dt, (high[n] - states[i, n]) / game.dt
                applied[i, k] = np.clip(applied[i, k], *reach)
    return applied


def braking(game: Game, player: int, state: Float[np.ndarray, "n"]) -> Float[np.ndarray, "m"]:
    """The control that would bring a player to rest within a step; it does not steer."""
    dynamics = game.players[player].dynamics
    control = np.zeros(dynamics.control_size)
    for k, n in rates(dynamics):
        control[k] = -state[n] / game.dt
    return control


def brake(game: Game, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
    """Controls that bring all agents to rest as fast as the limits allow, without steering."""
    controls = np.stack([braking(game, i, state) for i, state in enumerate(states)])
    return applicable(game, states, controls)


def advance(
    game: Game,
    states: Float[np.ndarray, "N n"],
    controls: Float[np.ndarray, "N m"],
    theta: tuple[dict[str, Any], ...],
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N"]]:
    """Next states, and what every player pays for `controls` and for the states they lead to.

    Discounted and undiscounted costs both count fully.
    """
    after, costs = _advance(game, states, controls, theta)
    after = np.array(after)
    # Rounding alone may leave a velocity 1e-16 beyond the limit that the solver insists on.
    for i, player in enumerate(game.players):
        if player.state_bounds is not None:
            for _, n in rates(player.dynamics):
                low, high = player.state_bounds.lower[0][n], player.state_bounds.upper[0][n]
                after[i, n] = np.clip(after[i, n], low, high)
    return after, np.array(costs)


@in_double_precision
@partial(jax.jit, static_argnums=0)
def _advance(
    game: Game,
    states: Float[Array, "N n"],
    controls: Float[Array, "N m"],
    theta: tuple[dict[str, Any], ...],
) -> tuple[Float[Array, "N n"], Float[Array, "N"]]:
    u = tuple(controls)
    x = tuple(
        player.dynamics(FIRST_STAGE, state, control)
        for player, state, control in zip(game.players, states, u, strict=True)
    )
    costs = [sum(stage_cost(game, i, FIRST_STAGE, x, u, own)) for i, own in enumerate(theta)]
    return jnp.stack(x), jnp.stack(costs)


@in_double_precision
@partial(jax.jit, static_argnums=0)
def observe(
    models: tuple[ObservationModel, ...], states: Float[Array, "N n"]
) -> tuple[Float[Array, "_"], ...]:
    """`h(x)` of several observers, without noise."""
    return tuple(model(tuple(states)) for model in models)
