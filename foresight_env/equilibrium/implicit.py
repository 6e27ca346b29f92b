"""The equilibrium as a differentiable function of `x0`, `theta` and `gamma`.

Implicit function theorem on the perturbed KKT system (paper, eq. 10, with the active set expressed
by the barrier): the tangent of the solution solves the Newton system of the solution with the
tangent of the residual as right-hand side. One factorisation serves all tangents, and JAX
transposes the stage recursions for reverse mode. Tangents of a solve that failed are NaN.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.interior_point import (
    Options,
    converged,
    evaluate,
    iterate,
    masks_of,
    stage_system,
    start_point,
    violation,
)
from foresight_env.equilibrium.kkt import Iterate, Parameters
from foresight_env.equilibrium.layout import Layout
from foresight_env.equilibrium.stagewise import factorise, solve_stages
from foresight_env.games.types import AnyArray, Scalar


class Equilibrium(NamedTuple):
    """Raw result of one solve on joint vectors."""

    point: Iterate
    costates: Float[Array, "T n"]
    error: Scalar
    complementarity: Scalar
    violation: Scalar
    iterations: Int[Array, ""]
    success: Bool[Array, ""]


def nudged_start(
    layout: Layout, options: Options, parameters: Parameters, u: Float[Array, "T m"], number: Array
) -> Iterate:
    """Where the attempt of that number begins, away from any symmetry of the first one's `u`."""
    # Incommensurable frequencies: no two agents are nudged alike, and runs repeat exactly.
    phase = jnp.arange(u.size, dtype=u.dtype).reshape(u.shape)
    u = u + 0.5 * number * jnp.sin(1.0 + 2.4 * phase)
    return start_point(layout, parameters, rollout(layout, parameters.x0, u), u, options)


def _solve(layout: Layout, options: Options, parameters: Parameters, start: Iterate) -> Equilibrium:
    """Attempts until one succeeds; the later ones start nudged (see `Options.attempts`)."""

    def attempt(state):
        number, begin, _, spent = state
        exact_below = options.exact_below * 10.0**number
        point, ev, iterations = iterate(layout, parameters, begin, options, exact_below)
        spent += iterations
        result = Equilibrium(
            point,
            ev.q,
            ev.error,
            ev.complementarity,
            violation(ev),
            spent,
            converged(ev, options),
        )
        again = nudged_start(layout, options, parameters, start.u, number + 1)
        return number + 1, again, result, spent

    def unsolved(state):
        number, _, result, _ = state
        return (number < options.attempts) & ~result.success

    zero, infinite = jnp.zeros((), int), jnp.asarray(jnp.inf)
    nothing = Equilibrium(
        start,
        jnp.zeros_like(start.x),
        infinite,
        infinite,
        infinite,
        zero,
        jnp.zeros((), bool),
    )
    return jax.lax.while_loop(unsolved, attempt, (zero, start, nothing, zero))[2]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def equilibrium(
    layout: Layout, options: Options, parameters: Parameters, start: Iterate
) -> Equilibrium:
    """Solve from `start`; differentiable by `parameters` (`start` has no influence)."""
    return _solve(layout, options, parameters, start)


@equilibrium.defjvp
def _equilibrium_jvp(layout, options, primals, tangents):
    parameters, start = primals
    result = equilibrium(layout, options, parameters, start)
    rate = solution_tangent(layout, options, result, parameters, tangents[0])
    zero = jax.tree.map(
        lambda v: (
            jnp.zeros(v.shape, v.dtype)
            if jnp.issubdtype(v.dtype, jnp.floating)
            else jnp.zeros(v.shape, jax.dtypes.float0)
        ),
        result,
    )
    return result, zero._replace(point=rate)


def solution_tangent(
    layout: Layout,
    options: Options,
    result: Equilibrium,
    parameters: Parameters,
    change: Parameters,
) -> Iterate:
    """Directional derivative of states, controls and multipliers."""
    masks = masks_of(layout)
    point = jax.tree.map(jax.lax.stop_gradient, result.point)
    fixed = jax.tree.map(jax.lax.stop_gradient, parameters)
    exact = jnp.zeros(())
    ev = evaluate(layout, masks, point, fixed, exact, options)
    factor = factorise(stage_system(layout, masks, point, ev))

    def conditions(p: Parameters) -> tuple[Array, Array, Array, Array]:
        at = evaluate(layout, masks, point, p, exact, options)
        res = at.residual
        return res.stationarity, res.defect, res.rows, at.lin.penalty

    _, (r_u, defect, rows, penalty) = jax.jvp(conditions, (fixed,), (change,))
    spare = jnp.where(masks.elastic, ev.lin.penalty - point.mult, 1.0)
    per_price = jnp.where(masks.elastic, point.excess / spare, 0.0)
    wanted = -rows + per_price * penalty
    n, m = layout.n, layout.m
    # dx_1 enters the first defect, whose derivative by x0 is A_1 dx0.
    dx, du = solve_stages(
        factor,
        jnp.zeros_like(point.x),
        jnp.concatenate([r_u, -wanted], axis=1),
        defect,
        jnp.zeros(n),
    )
    du, mult = du[:, :m], du[:, m:]
    dw = jnp.concatenate([dx, du], axis=1)
    ok = jnp.where(result.success, 1.0, jnp.nan)
    excess = per_price * (mult - penalty)
    slope = jnp.einsum("tka,ta->tk", ev.lin.jacobian, dw)
    low, high = masks.low * dw, -masks.high * dw
    return jax.tree.map(
        lambda v: ok * v,
        Iterate(
            dx,
            du,
            low,
            high,
            -point.mult_low * low / point.slack_low,
            -point.mult_high * high / point.slack_high,
            masks.inequality * (slope + excess + rows),
            excess,
            mult,
        ),
    )


def rollout(
    layout: Layout, x0: Float[AnyArray, "n"], u: Float[AnyArray, "T m"]
) -> Float[Array, "T n"]:
    """States that controls lead to."""
    dynamics = [p.dynamics for p in layout.game.players]

    def step(x, stage):
        t, control = stage
        parts = zip(dynamics, layout.split_states(x), layout.split_controls(control), strict=True)
        x = jnp.concatenate([f(t, s, c) for f, s, c in parts])
        return x, x

    _, x = jax.lax.scan(step, x0, (jnp.arange(1, layout.game.horizon + 1), u))
    return x


def cold_start(layout: Layout, options: Options, parameters: Parameters) -> Iterate:
    """Nobody acts."""
    u = jnp.zeros((layout.game.horizon, layout.m))
    return start_point(layout, parameters, rollout(layout, parameters.x0, u), u, options)
