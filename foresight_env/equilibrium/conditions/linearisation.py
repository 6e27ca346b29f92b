"""Linearisation of a game's first-order conditions, per stage.

Identical players are evaluated together (module `identical_players`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.identical_players import (
    IdenticalPlayers,
    block_diagonal,
    identical_players,
    in_place,
    inputs_of,
    moving_alike,
    spread,
    stack,
)
from foresight_env.equilibrium.conditions.kkt import (
    Iterate,
    Parameters,
    discount_ratios,
    row_shares,
)
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import split
from foresight_env.games.constraints import as_rows
from foresight_env.games.costs import Composite
from foresight_env.games.dynamics import Dynamics
from foresight_env.games.types import Controls, CostFunction, Scalar, States, Theta

Stage = tuple[States, Controls]
"""All players' states and controls of one stage. Costs are differentiated by these parts, not by
the stage vector: every slice of that would become a padded sum."""


class Linearisation(NamedTuple):
    """Everything that a Newton step needs, per stage."""

    gradient: Float[Array, "T w"]
    """Each player's Lagrangian differentiated by its own part of `w`, without costates."""
    hessian: Float[Array, "T w w"]
    """Rows: a player's own part; columns: all players'."""
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


class FirstOrder(NamedTuple):
    """First-order part of a linearisation: costs, constraints and discount factors at a point."""

    gradient: Float[Array, "T w"]
    rho: Float[Array, "T n"]
    values: Float[Array, "T K"]
    penalty: Float[Array, "K"]


def _stage_cost(
    cost: CostFunction,
    i: int,
    t: Array,
    now: Stage,
    at: Stage,
    theta: Theta,
    convexity: Scalar | None,
) -> Scalar:
    """A cost, its second derivatives at `at` Gauss-Newton by `convexity` parts, else exact."""
    if not isinstance(cost, Composite):
        return jnp.asarray(cost(i, t, *now, theta))

    def residual(stage: Stage) -> Array:
        return jnp.asarray(cost.residual(i, t, *stage, theta))

    return cost.loss(_partly_linear(residual, now, at, convexity), theta)


def _bound(cost: Any, constants: Any) -> CostFunction:
    """A cost with a member's own numbers, where it has any."""
    return cost if constants is None else cost.with_constants(constants)


def _partly_linear(
    function: Callable[[Any], Array], now: Any, at: Any, convexity: Scalar | None
) -> Array:
    if convexity is None:
        return function(now)
    away = jax.tree.map(jnp.subtract, now, at)
    value, slope = jax.jvp(function, (at,), (away,))
    return convexity * (value + slope) + (1.0 - convexity) * function(now)


def _with_jacobian(function: Callable[[Array], Array], at: Array) -> tuple[Array, Array]:
    """Jacobian and value from one evaluation."""
    return jax.jacfwd(lambda v: (function(v),) * 2, has_aux=True)(at)


def _rows(these: IdenticalPlayers, t: Array, stage: Stage, theta: Theta) -> Array:
    """A player's own constraint rows."""
    values = [as_rows(g(these.first, t, *stage, theta)) for g in these.constraints]
    return jnp.concatenate(values)


def _moves(layout: Layout, t: Array, x: Array, u: Array) -> tuple[Array, Array, Array]:
    """`A` (n, n) and `B` (n, m) of one stage, and the states (n,) that it leads to."""
    a, b, nexts = [], [], []
    for members in moving_alike(layout.game):
        dynamics = layout.game.players[members.start].dynamics
        size = dynamics.state_size

        def move(v: Array, dynamics: Dynamics = dynamics, size: int = size) -> Array:
            return dynamics(t, v[:size], v[size:])

        jacobian, following = jax.vmap(partial(_with_jacobian, move))(
            inputs_of(layout, x, u, members)
        )
        a.append(spread(jacobian[..., :size]))
        b.append(spread(jacobian[..., size:]))
        nexts.append(following.ravel())
    return block_diagonal(a), block_diagonal(b), jnp.concatenate(nexts)


class _Weights(NamedTuple):
    """How costs and constraint rows count, per stage."""

    ratios: Float[Array, "T N"]
    undiscounted: Float[Array, "T N"]
    """Of undiscounted costs, in each player's units of the stage."""
    share: Float[Array, "T K w"]
    penalty: Float[Array, "K"]


def _weights(layout: Layout, point: Iterate, parameters: Parameters) -> _Weights:
    ratios = discount_ratios(layout, parameters.gamma)
    return _Weights(
        ratios,
        jnp.exp(-jnp.cumsum(jnp.log(jnp.maximum(ratios, 1e-300)), axis=0)),
        row_shares(layout, ratios),
        layout.penalties(parameters.theta).astype(point.x.dtype),
    )


class _Member(NamedTuple):
    """Arguments of a player's Lagrangian other than the stage vector."""

    own: Theta
    numbers: tuple[Any, ...]
    scale: Scalar
    """Of undiscounted costs."""
    price: Float[Array, "R"]
    """Of the player's constraint rows."""


def _lagrangian(
    these: IdenticalPlayers,
    t: Array,
    now: Stage,
    at: Stage,
    member: _Member,
    convexity: Scalar | None,
) -> Scalar:
    """A member's, without shared constraints."""
    own, numbers, scale, price = member
    total = jnp.zeros(())
    plain = len(these.costs)
    for cost, number in zip(these.costs, numbers[:plain], strict=True):
        total += _stage_cost(_bound(cost, number), these.first, t, now, at, own, convexity)
    for cost, number in zip(these.undiscounted_costs, numbers[plain:], strict=True):
        mine = _stage_cost(_bound(cost, number), these.first, t, now, at, own, convexity)
        total += scale * mine
    if these.constraints:
        values = _partly_linear(lambda v: _rows(these, t, v, own), now, at, convexity)
        total -= jnp.sum(price * values)
    return total


def _views(
    layout: Layout,
    these: IdenticalPlayers,
    own: Theta,
    w: Array,
    scale: Array,
    mult: Array,
    share: Array,
) -> tuple[Array, _Member]:
    """Stage vectors as the members see them, and what else their Lagrangians depend on."""
    numbered = np.array(these.members)
    begins = np.array([layout.state_slices[i].start for i in numbered])
    price = share[these.rows, begins[:, None]] * mult[these.rows]
    seen = w[None] if len(numbered) == 1 else w[these.view]
    return seen, _Member(own, these.constants, scale[numbered], price)


def _in_order(numbers: list[np.ndarray], rows: list[Array]) -> Array:
    """Constraint rows in the order of their numbers."""
    order, joined = np.argsort(np.concatenate(numbers)), jnp.concatenate(rows)
    return joined if (order == np.arange(order.size)).all() else joined[order]


def first_order(layout: Layout, point: Iterate, parameters: Parameters) -> FirstOrder:
    """Return the first-order part of `linearise`, without dynamics and constraints' derivatives."""
    theta = parameters.theta
    weights = _weights(layout, point, parameters)
    mult = split(layout, point.mult)
    groups = [(these, stack(theta, these.members)) for these in identical_players(layout, theta)]

    def own_part(these, t, w, member):
        """A player's gradient (own,) and its constraint rows."""
        at = layout.split(w)
        i = these.first

        def total(x, u):
            states, controls = at
            now = (*states[:i], x, *states[i + 1 :]), (*controls[:i], u, *controls[i + 1 :])
            return _lagrangian(these, t, now, at, member, None)

        slope = jnp.concatenate(jax.grad(total, argnums=(0, 1))(at[0][i], at[1][i]))
        return slope, _rows(these, t, at, member.own) if these.constraints else None

    def stage(t, w, scale, mult, share):
        gradient = jnp.zeros_like(w)
        numbers, values = [np.arange(0)], [jnp.zeros(0, w.dtype)]
        for these, own in groups:
            seen, members = _views(layout, these, own, w, scale, mult, share)
            slopes, rows = jax.vmap(partial(own_part, these, t))(seen, members)
            gradient += in_place(layout, these.members, slopes)
            if rows is not None:
                numbers.append(these.rows.ravel())
                values.append(rows.ravel())
        if layout.game.shared:
            first = sum(map(len, numbers))
            price = share[first:] * mult[first:, None]
            jacobian, shared = _with_jacobian(lambda v: layout.shared_values(t, v, theta), w)
            gradient -= jnp.sum(price * jacobian, axis=0)
            numbers.append(np.arange(first, len(layout.rows)))
            values.append(shared)
        return gradient, _in_order(numbers, values)

    stages = jnp.arange(1, layout.game.horizon + 1)
    gradient, values = jax.vmap(stage)(
        stages, jnp.concatenate([point.x, point.u], axis=1), weights.undiscounted, mult.row,
        weights.share,
    )  # fmt: skip
    rho = weights.ratios[:, layout.state_owner]
    return FirstOrder(gradient - mult.low + mult.high, rho, values, weights.penalty)


def linearise(
    layout: Layout, point: Iterate, parameters: Parameters, convexity: Scalar
) -> Linearisation:
    """Derivatives of all stages at `point`.

    `convexity` is the convexification weight: 1 drops the curvature of proximity terms and
    constraints (every player's own problem is then convex when its costs are), 0 is Newton's exact
    matrix.
    """
    game = layout.game
    theta = parameters.theta
    stages = jnp.arange(1, game.horizon + 1)
    weights = _weights(layout, point, parameters)
    rho = weights.ratios[:, layout.state_owner]
    mult = split(layout, point.mult)
    previous = jnp.concatenate([parameters.initial_state[None], point.x[:-1]])
    w = jnp.concatenate([point.x, point.u], axis=1)

    groups = [(these, stack(theta, these.members)) for these in identical_players(layout, theta)]

    def own_part(these, t, w, member, back):
        """A player's gradient (own,) and Hessian rows (own, w) by the player's entries of `w`.

        The Hessian is symmetric: its rows are its columns, each the change of the whole gradient in
        one of the player's own directions.
        """
        directions, at = jnp.eye(w.size)[layout.owner == these.first], layout.split(w)

        def slope(v):
            x, u = jax.grad(_lagrangian, argnums=2)(these, t, v, at, member, convexity)
            return jnp.concatenate([*x, *u])

        # The gradient comes along with its changes: derivatives are traced once, not twice.
        gradient, rows = jax.vmap(
            lambda e: jax.jvp(slope, (at,), (layout.split(e),)), out_axes=(None, 0)
        )(directions)
        x, u = layout.split(gradient)
        return jnp.concatenate([x[these.first], u[these.first]]), returned(these, rows, back)

    def own_rows(these, t, w, own, back):
        """A player's constraint rows (own,) and their Jacobian (own, w)."""
        jacobian, values = _with_jacobian(lambda v: _rows(these, t, layout.split(v), own), w)
        return values, returned(these, jacobian, back)

    def returned(these, columns, back):
        """From a player's view of the stage vector to the vector itself."""
        return columns if len(these.members) == 1 else columns[:, back]

    def shared_part(t, w, price):
        """Parts of shared rows, at each player's own prices (shared, w)."""

        def rows(v):
            return layout.shared_values(t, v, theta)

        def curvature(e, paid):
            slope = jax.grad(lambda v: -jnp.sum(paid * _partly_linear(rows, v, w, convexity)))
            return jax.jvp(slope, (w,), (e,))[1]

        jacobian, values = _with_jacobian(rows, w)
        hessian = jax.vmap(curvature)(jnp.eye(w.size), price.T)
        return -jnp.sum(price * jacobian, axis=0), hessian, values, jacobian

    def stage(t, w, xp, scale, mult, share):
        gradient, hessian = jnp.zeros_like(w), jnp.zeros((w.size, w.size), w.dtype)
        numbers, values = [np.arange(0)], [jnp.zeros(0, w.dtype)]
        jacobians = [jnp.zeros((0, w.size), w.dtype)]
        for these, own in groups:
            back = jnp.asarray(these.back)
            seen, members = _views(layout, these, own, w, scale, mult, share)
            slopes, curves = jax.vmap(partial(own_part, these, t))(seen, members, back)
            gradient += in_place(layout, these.members, slopes)
            hessian += in_place(layout, these.members, curves)
            if these.constraints:
                value, jacobian = jax.vmap(partial(own_rows, these, t))(seen, own, back)
                numbers.append(these.rows.ravel())
                values.append(value.ravel())
                jacobians.append(jacobian.reshape(-1, w.size))
        if game.shared:
            first = sum(map(len, numbers))
            price = share[first:] * mult[first:, None]
            slopes, curves, value, jacobian = shared_part(t, w, price)
            gradient, hessian = gradient + slopes, hessian + curves
            numbers.append(np.arange(first, len(layout.rows)))
            values.append(value)
            jacobians.append(jacobian)
        value, jacobian = _in_order(numbers, values), _in_order(numbers, jacobians)
        a, b, following = _moves(layout, t, xp, w[layout.n :])
        return gradient, hessian, a, b, following - w[: layout.n], value, jacobian

    gradient, hessian, a, b, defect, values, jacobian = jax.vmap(stage)(
        stages, w, previous, weights.undiscounted, mult.row, weights.share
    )
    gradient = gradient - mult.low + mult.high
    return Linearisation(
        gradient,
        hessian,
        a,
        b,
        defect,
        rho,
        values,
        jacobian,
        weights.share,
        weights.penalty,
        previous,
    )
