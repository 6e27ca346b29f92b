"""Variables of a game's first-order conditions (paper, eqs. 4 and 5).

Current-value form. Player i's stationarity at stage t is divided by `Gamma^i(t)`, so its costate
`q` (of that player's state; other players' states are not its decision) and its multipliers have
units of the player's stage cost at t, and only ratios `rho_t = Gamma(t) / Gamma(t - 1)` appear:

    q_t = d_x (c_t - lambda_t' g_t) + rho_{t+1} A_{t+1}' q_{t+1},
    0   = d_u (c_t - lambda_t' g_t) + B_t' q_t.

Costates are eliminated by that recursion, so the unknowns are states, controls, multipliers,
slacks.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.types import AnyArray, Theta


class Parameters(NamedTuple):
    """Parameters of a game's equilibrium."""

    initial_state: Float[AnyArray, "n"]
    """Joint state at t = 1."""
    theta: tuple[Theta, ...]
    """One mapping of cost parameters per player."""
    gamma: Float[AnyArray, "N"]
    """One discount factor per player."""


class Iterate(NamedTuple):
    """Unknowns of the mixed complementarity problem; columns of pairs as in module `pairs`."""

    x: Float[Array, "T n"]
    """States that stages lead to, x_2 to x_{T+1}."""
    u: Float[Array, "T m"]
    slack: Float[Array, "T P"]
    mult: Float[Array, "T P"]
    """In units of each player's stage cost at t; the last columns are those of constraint rows."""


def discount_ratios(layout: Layout, gamma: Float[AnyArray, "N"]) -> Float[Array, "T N"]:
    """`Gamma(t) / Gamma(t - 1)` for t = 1..T."""
    stages = jnp.arange(layout.game.horizon, dtype=gamma.dtype)
    columns = [
        jax.vmap(p.discounting.ratio, in_axes=(0, None))(stages, gamma[i])
        for i, p in enumerate(layout.game.players)
    ]
    return jnp.stack([jnp.broadcast_to(c, stages.shape) for c in columns], axis=1)


def row_shares(layout: Layout, ratios: Float[Array, "T N"]) -> Float[Array, "T K w"]:
    """Weights of each row's multiplier in each player's current-value conditions."""
    horizon, count = ratios.shape
    if not layout.rows:
        return jnp.zeros((horizon, 0, layout.n + layout.m), ratios.dtype)
    # A common multiplier counts in the units of the most myopic player at each stage: the weights
    # Gamma_min / Gamma_i are then at most 1 and cannot overflow.
    log_weight = jnp.cumsum(jnp.log(jnp.maximum(ratios, 1e-300)), axis=0)
    columns = []
    for row in layout.rows:
        binds = jnp.asarray(row.binds, ratios.dtype)
        if row.common:
            lowest = jnp.min(jnp.where(binds > 0, log_weight, jnp.inf), axis=1, keepdims=True)
            columns.append(binds * jnp.exp(jnp.where(binds > 0, lowest - log_weight, 0.0)))
        else:
            columns.append(jnp.broadcast_to(binds, (horizon, count)))
    return jnp.stack(columns, axis=1)[:, :, layout.owner]
