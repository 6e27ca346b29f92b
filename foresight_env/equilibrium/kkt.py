"""First-order conditions of a game and their linearisation (paper, eqs. 4 and 5).

Current-value form. Player i's stationarity at stage t is divided by `Gamma^i(t)`, so its costate
`q` (of its own state; other players' states are not its decision) and its multipliers count in
units of its own stage cost at t, and only ratios `rho_t = Gamma(t) / Gamma(t - 1)` appear:

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

from foresight_env.equilibrium.layout import Layout
from foresight_env.equilibrium.pairs import split
from foresight_env.equilibrium.recursion import affine_recursion
from foresight_env.games.costs import Composite
from foresight_env.games.types import AnyArray, CostFunction, Scalar, Theta


class Parameters(NamedTuple):
    """What a game's equilibrium depends on."""

    x0: Float[AnyArray, "n"]
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


class Linearisation(NamedTuple):
    """Everything that a Newton step needs, per stage."""

    gradient: Float[Array, "T w"]
    """Each player's Lagrangian differentiated by its own part of `w`, without costates."""
    hessian: Float[Array, "T w w"]
    """Rows: a player's own part; columns: everybody's. NaN where it was not asked for."""
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    defect: Float[Array, "T n"]
    rho: Float[Array, "T n"]
    values: Float[Array, "T K"]
    jacobian: Float[Array, "T K w"]
    share: Float[Array, "T K w"]
    """How strongly row k's multiplier acts on the owner of an entry of `w`."""
    penalty: Float[Array, "K"]
    previous: Float[Array, "T n"]
    """The states that stages start from: x_1 (given) to x_T."""


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


def _stage_cost(
    cost: CostFunction,
    i: int,
    t: Array,
    w: Array,
    at: Array,
    theta: Theta,
    layout: Layout,
    convexity: Scalar | None,
) -> Scalar:
    """A cost whose second derivatives at `at` are `convexity` parts Gauss-Newton, rest exact."""
    x, u = layout.split(w)
    if not isinstance(cost, Composite):
        return jnp.asarray(cost(i, t, x, u, theta))

    def inner(v: Array) -> Array:
        vx, vu = layout.split(v)
        return jnp.asarray(cost.inner(i, t, vx, vu, theta))

    return cost.outer(_partly_linear(inner, w, at, convexity), theta)


def _partly_linear(function, w: Array, at: Array, convexity: Scalar | None) -> Array:
    if convexity is None:
        return function(w)
    value, slope = jax.jvp(function, (at,), (w - at,))
    return convexity * (value + slope) + (1.0 - convexity) * function(w)


def linearise(
    layout: Layout, point: Iterate, parameters: Parameters, convexity: Scalar | None
) -> Linearisation:
    """Derivatives of all stages at `point`.

    `convexity` = 1 drops the curvature of proximity terms and constraints (every player's
    own problem is then convex when its costs are); 0 is Newton's exact matrix; None: there is no
    `hessian`, which is most of the work.
    """
    game = layout.game
    theta = parameters.theta
    stages = jnp.arange(1, game.horizon + 1)
    ratios = discount_ratios(layout, parameters.gamma)
    share = row_shares(layout, ratios)
    undiscounted = jnp.exp(-jnp.cumsum(jnp.log(jnp.maximum(ratios, 1e-300)), axis=0))
    rho = ratios[:, layout.state_owner]
    penalty = layout.penalties(theta).astype(point.x.dtype)
    mult = split(layout, point.mult)
    previous = jnp.concatenate([parameters.x0[None], point.x[:-1]])
    w = jnp.concatenate([point.x, point.u], axis=1)

    def lagrangian(i, t, w, at, scale, mult, row_share):
        player = game.players[i]
        total = jnp.zeros(())
        for cost in player.costs:
            total += _stage_cost(cost, i, t, w, at, theta[i], layout, convexity)
        for cost in player.undiscounted_costs:
            total += scale[i] * _stage_cost(cost, i, t, w, at, theta[i], layout, convexity)
        rows = layout.rows_of(i)
        if rows.size:
            price = (row_share[:, layout.state_slices[i].start] * mult)[rows]
            values = _partly_linear(lambda v: layout.values_of(i, t, v, theta), w, at, convexity)
            total -= jnp.sum(price * values)
        return total

    def own_part(i, t, w, scale, mult, row_share):
        """Player i's gradient (own,) and Hessian rows (own, w) of its own state, of its control.

        The Hessian is symmetric: its rows are its columns, each the change of the whole gradient in
        one of the player's own directions.
        """

        def slope(v):
            return jax.grad(lagrangian, argnums=2)(i, t, v, w, scale, mult, row_share)

        directions = jnp.eye(w.size)[layout.owner == i]
        if convexity is None:
            gradient, rows = slope(w), jnp.full_like(directions, jnp.nan)
        else:
            # The gradient comes along with its changes: derivatives are traced once, not twice.
            gradient, rows = jax.vmap(lambda e: jax.jvp(slope, (w,), (e,)), out_axes=(None, 0))(
                directions
            )
        of_state, of_control = layout.split(gradient)
        size = game.state_sizes[i]
        return (of_state[i], rows[:size]), (of_control[i], rows[size:])

    def stage(t, w, xp, scale, mult, row_share):
        players = range(len(game.players))
        parts = [own_part(i, t, w, scale, mult, row_share) for i in players]
        states, controls = zip(*parts, strict=True)
        gradients, rows = zip(*states, *controls, strict=True)
        gradient, hessian = jnp.concatenate(gradients), jnp.concatenate(rows)
        a_blocks, b_blocks, nexts = [], [], []
        x_now, u_now = layout.split_states(xp), layout.split_controls(w[layout.n :])
        for i, player in enumerate(game.players):
            dyn = player.dynamics
            (a_i, b_i), following = jax.jacfwd(
                lambda s, c, dyn=dyn: (dyn(t, s, c),) * 2, argnums=(0, 1), has_aux=True
            )(x_now[i], u_now[i])
            a_blocks.append(a_i)
            b_blocks.append(b_i)
            nexts.append(following)
        a = jax.scipy.linalg.block_diag(*a_blocks)
        b = jax.scipy.linalg.block_diag(*b_blocks)
        defect = jnp.concatenate(nexts) - w[: layout.n]
        jacobian, values = jax.jacfwd(
            lambda v: (layout.constraint_values(t, v, theta),) * 2, has_aux=True
        )(w)
        return gradient, hessian, a, b, defect, values, jacobian

    gradient, hessian, a, b, defect, values, jacobian = jax.vmap(stage)(
        stages, w, previous, undiscounted, mult.row, share
    )
    gradient = gradient - mult.low + mult.high
    return Linearisation(
        gradient, hessian, a, b, defect, rho, values, jacobian, share, penalty, previous
    )


def costates(lin: Linearisation, n: int) -> Float[Array, "T n"]:
    """Each player's current-value costate of its own state, by the backward recursion."""

    # q_t = g_t + (rho A)_{t+1}' q_{t+1}, and nothing comes after the last stage.
    pulled = lin.rho[:, :, None] * jnp.swapaxes(lin.a, 1, 2)
    pulled = jnp.concatenate([pulled[1:], jnp.zeros_like(pulled[:1])])
    zero = jnp.zeros(n, lin.gradient.dtype)
    return affine_recursion(pulled, lin.gradient[:, :n], zero, reverse=True)


def stationarity(lin: Linearisation, q: Float[Array, "T n"]) -> Float[Array, "T m"]:
    """`d_u L + B' q`: zero where no player can improve to first order."""
    n = q.shape[1]
    return lin.gradient[:, n:] + jnp.einsum("tnm,tn->tm", lin.b, q)
