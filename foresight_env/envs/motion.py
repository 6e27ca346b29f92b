"""One step of the world: motion and stage costs as the scenario's game defines them."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games import Game, ObservationModel, stage_cost
from foresight_env.precision import in_double_precision
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT, SPEED_LIMIT

FIRST_STAGE = 1
"""Every step of the world is the first stage of the game that agents play from there on."""


def applicable(
    states: Float[np.ndarray, "N 4"], controls: Float[np.ndarray, "N 2"], dt: float
) -> Float[np.ndarray, "N 2"]:
    """`controls` (m/s^2) reduced to the limits of control and of the next velocity, per axis."""
    velocities = states[:, 2:]
    limited = np.clip(controls, -CONTROL_LIMIT, CONTROL_LIMIT)
    lowest, highest = (-SPEED_LIMIT - velocities) / dt, (SPEED_LIMIT - velocities) / dt
    applied: Float[np.ndarray, "N 2"] = np.clip(limited, lowest, highest)
    return applied


def advance(
    game: Game,
    states: Float[np.ndarray, "N 4"],
    controls: Float[np.ndarray, "N 2"],
    theta: tuple[dict[str, Any], ...],
) -> tuple[Float[np.ndarray, "N 4"], Float[np.ndarray, "N"]]:
    """Next states, and what every player pays for `controls` and for the states they lead to.

    Discounted and undiscounted costs both count fully.
    """
    after, costs = _advance(game, states, controls, theta)
    after = np.array(after)
    # Rounding alone may leave a velocity 1e-16 beyond the limit that the solver insists on.
    after[:, 2:] = np.clip(after[:, 2:], -SPEED_LIMIT, SPEED_LIMIT)
    return after, np.array(costs)


@in_double_precision
@partial(jax.jit, static_argnums=0)
def _advance(
    game: Game,
    states: Float[Array, "N 4"],
    controls: Float[Array, "N 2"],
    theta: tuple[dict[str, Any], ...],
) -> tuple[Float[Array, "N 4"], Float[Array, "N"]]:
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
    models: tuple[ObservationModel, ...], states: Float[Array, "N 4"]
) -> tuple[Float[Array, "_"], ...]:
    """`h(x)` of several observers, without noise."""
    return tuple(model(tuple(states)) for model in models)


def closest_approach(
    states: Float[np.ndarray, "N 4"], controls: Float[np.ndarray, "N 2"], dt: float
) -> Float[np.ndarray, "N N"]:
    """Smallest distance (m) between the centres of each pair during one step; infinite diagonal.

    Exact for double integrators: the relative position is a quadratic in time, so its squared
    length is least at an end of the step or where a cubic is zero.
    """
    count = len(states)
    distances = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i):
            # Relative position as a polynomial in the fraction of the step that has passed.
            relative = np.stack(
                [
                    states[i, :2] - states[j, :2],
                    dt * (states[i, 2:] - states[j, 2:]),
                    0.5 * dt**2 * (controls[i] - controls[j]),
                ]
            )
            distances[i, j] = distances[j, i] = _least_length(relative)
    return distances


def _least_length(curve: Float[np.ndarray, "3 2"]) -> float:
    """Least length of `curve[0] + curve[1] s + curve[2] s^2` over s in [0, 1]."""
    start, slope, bend = curve
    # Half the derivative of the squared length, highest power first.
    cubic = np.array(
        [
            2.0 * bend @ bend,
            3.0 * slope @ bend,
            slope @ slope + 2.0 * start @ bend,
            start @ slope,
        ]
    )
    # Coefficients that are rounding beside the others would make the roots overflow.
    cubic[np.abs(cubic) < 1e-14 * np.max(np.abs(cubic))] = 0.0
    roots = np.roots(cubic).real
    # A complex root's real part is one more harmless sample.
    moments = np.clip(np.concatenate([[0.0, 1.0], roots]), 0.0, 1.0)[:, None]
    return float(np.min(np.linalg.norm(start + moments * (slope + moments * bend), axis=1)))
