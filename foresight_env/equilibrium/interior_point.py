"""Primal-dual interior-point method for a game's mixed complementarity problem.

Every inequality `g >= 0` gets a slack and a multiplier with `slack * multiplier = barrier`;
Newton's method follows that path down to `Options.barrier` with Mehrotra's predictor and corrector
(Nocedal and Wright, "Numerical Optimization", 2nd ed., algorithm 14.3). What each iteration solves
has the size of one stage (module `stagewise`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.kkt import (
    Iterate,
    Linearisation,
    Parameters,
    costates,
    linearise,
    stationarity,
)
from foresight_env.equilibrium.layout import Layout
from foresight_env.equilibrium.stagewise import Factor, StageSystem, factorise, solve_stages
from foresight_env.games.types import Scalar


@dataclass(frozen=True)
class Options:
    """Settings of the forward solver; the defaults are those that the benchmarks measured."""

    tolerance: float = 1e-8
    """Largest entry of the scaled KKT residual at which a game counts as solved."""
    max_iterations: int = 80
    """Newton steps per attempt."""
    barrier: float = 1e-9
    """Complementarity product at the solution: the solution is a smooth function of parameters."""
    start_barrier: float = 0.1
    """Complementarity product of a cold start."""
    exact_below: float = 1e-2
    """Residual below which curvature of proximity terms and constraints is used exactly."""
    attempts: int = 3
    """A failed solve starts again this often, from controls nudged off any symmetry and with the
    exact curvature used earlier."""


class Residual(NamedTuple):
    """Left-hand sides of the perturbed KKT conditions that a Newton step drives to zero."""

    stationarity: Float[Array, "T m"]
    defect: Float[Array, "T n"]
    low: Float[Array, "T w"]
    high: Float[Array, "T w"]
    rows: Float[Array, "T K"]


class Masks(NamedTuple):
    """Which bounds and rows exist."""

    low: Float[Array, "T w"]
    high: Float[Array, "T w"]
    lower: Float[Array, "T w"]
    upper: Float[Array, "T w"]
    inequality: Float[Array, "K"]
    elastic: Bool[Array, "K"]
    equality: Bool[Array, "K"]


class Evaluation(NamedTuple):
    """A point with its derivatives."""

    lin: Linearisation
    q: Float[Array, "T n"]
    residual: Residual
    error: Scalar
    complementarity: Scalar


class Loop(NamedTuple):
    """State of the iteration."""

    point: Iterate
    evaluation: Evaluation
    iteration: Int[Array, ""]
    finite: Bool[Array, ""]


EQUALITY_REGULARISATION = 1e-8
"""Proximal term of equality multipliers: keeps the stage matrices regular without a constraint
qualification; it vanishes at the solution."""
VIOLATED = 1e-4
"""Violation above which constraints count as unmet."""
RUNAWAY_MULTIPLIER = 1e10
"""Multiplier of an unmet constraint at which the method gives up, before numbers overflow."""


def masks_of(layout: Layout) -> Masks:
    """Static masks; absent bounds become 0 with an inert slack."""
    low, high = (jnp.asarray(b) for b in layout.bounds)
    has_low, has_high = jnp.isfinite(low), jnp.isfinite(high)
    return Masks(
        has_low.astype(float),
        has_high.astype(float),
        jnp.where(has_low, low, 0.0),
        jnp.where(has_high, high, 0.0),
        jnp.asarray(~layout.equality, float),
        jnp.asarray(layout.elastic, bool),
        jnp.asarray(layout.equality, bool),
    )


def evaluate(
    layout: Layout,
    masks: Masks,
    point: Iterate,
    parameters: Parameters,
    convexity: Scalar,
    options: Options,
) -> Evaluation:
    """Derivatives and residuals at `point`."""
    lin = linearise(layout, point, parameters, convexity)
    q = costates(lin, layout.n)
    w = jnp.concatenate([point.x, point.u], axis=1)
    slack = jnp.where(masks.equality, 0.0, point.slack) - jnp.where(
        masks.elastic, point.excess, 0.0
    )
    residual = Residual(
        stationarity(lin, q),
        lin.defect,
        masks.low * (w - masks.lower - point.slack_low),
        masks.high * (masks.upper - w - point.slack_high),
        lin.values - slack,
    )
    error = jnp.max(jnp.stack([_largest(r) for r in residual]))
    off_path = targets(masks, point, lin.penalty, jnp.asarray(options.barrier))
    complementarity = jnp.max(jnp.stack([_largest(v) for v in off_path]))
    return Evaluation(lin, q, residual, error, complementarity)


def converged(ev: Evaluation, options: Options) -> Bool[Array, ""]:
    """Whether the perturbed KKT conditions hold, complementarity to a hundredth of the barrier.

    So narrow a path makes the solution a function of the parameters alone, start or no start.
    """
    return (ev.error <= options.tolerance) & (ev.complementarity <= 0.01 * options.barrier)


def violation(ev: Evaluation) -> Scalar:
    """Largest violation of a bound or a constraint."""
    residual = ev.residual
    parts = (residual.low, residual.high, residual.rows)
    return jnp.max(jnp.stack([_largest(v) for v in parts]))


def largest_multiplier(point: Iterate) -> Scalar:
    """Largest multiplier of a bound or a constraint."""
    parts = (point.mult, point.mult_low, point.mult_high)
    return jnp.max(jnp.stack([_largest(v) for v in parts]))


def _largest(values: Array) -> Scalar:
    return jnp.max(jnp.abs(values), initial=0.0)


def stage_system(layout: Layout, masks: Masks, point: Iterate, ev: Evaluation) -> StageSystem:
    """The linear system with slacks and bound multipliers eliminated."""
    lin = ev.lin
    diagonal = (
        masks.low * point.mult_low / point.slack_low
        + masks.high * point.mult_high / point.slack_high
    )
    hessian = lin.hessian + jax.vmap(jnp.diag)(diagonal)
    curvature = dynamics_hessian(layout, point, ev)
    b = lin.b
    if layout.rows:
        # Row multipliers stay among a stage's unknowns, beside its controls. Eliminating them too
        # would put weights of 1e11 on positions and lose the game's own curvature to rounding.
        softness = jax.vmap(jnp.diag)(row_softness(masks, point, lin.penalty))
        pull = -jnp.swapaxes(lin.share * lin.jacobian, 1, 2)
        hessian = jnp.concatenate(
            [
                jnp.concatenate([hessian, pull], axis=2),
                jnp.concatenate([lin.jacobian, softness], axis=2),
            ],
            axis=1,
        )
        extra = len(layout.rows)
        curvature = jnp.pad(curvature, ((0, 0), (0, extra), (0, extra)))
        b = jnp.pad(b, ((0, 0), (0, 0), (0, extra)))
    return StageSystem(hessian, curvature, lin.a, b, lin.rho)


def row_softness(masks: Masks, point: Iterate, penalty: Array) -> Float[Array, "T K"]:
    """`-d g / d mult` of each row with its slack eliminated."""
    spare = jnp.where(masks.elastic, penalty - point.mult, 1.0)
    softness = point.slack / jnp.where(masks.equality, 1.0, point.mult) + jnp.where(
        masks.elastic, point.excess / spare, 0.0
    )
    return jnp.where(masks.equality, EQUALITY_REGULARISATION, softness)


def dynamics_hessian(layout: Layout, point: Iterate, ev: Evaluation) -> Float[Array, "T w w"]:
    """Second derivatives of `q_t' f(t, x_t, u_t)` by `(x_t, u_t)`; zero for linear dynamics.

    They are kept where `linearise` drops those of proximity: a car far from its goal has large
    costates, and without this term nothing tells the method how its controls act on the heading.
    """
    shape = ev.lin.hessian.shape
    if all(p.dynamics.linear for p in layout.game.players):
        return jnp.zeros(shape, ev.lin.hessian.dtype)

    def stage(t, xp, u, q):
        def total(v):
            x_parts, u_parts = layout.split(v)
            nexts = [
                p.dynamics(t, s, c)
                for p, s, c in zip(layout.game.players, x_parts, u_parts, strict=True)
            ]
            return jnp.dot(q, jnp.concatenate(nexts))

        return jax.hessian(total)(jnp.concatenate([xp, u]))

    stages = jnp.arange(1, shape[0] + 1)
    return jax.vmap(stage)(stages, ev.lin.previous, point.u, ev.q)


class Targets(NamedTuple):
    """Right-hand sides of the complementarity rows: wanted change of `slack * multiplier`."""

    low: Array
    high: Array
    rows: Array
    excess: Array


def targets(
    masks: Masks,
    point: Iterate,
    penalty: Array,
    barrier: Scalar,
    affine: Iterate | None = None,
    second_order: Scalar | float = 1.0,
) -> Targets:
    """`barrier - slack * multiplier`, less `second_order` parts of the predictor's product."""
    low = barrier - point.slack_low * point.mult_low
    high = barrier - point.slack_high * point.mult_high
    rows = barrier - point.slack * point.mult
    excess = barrier - point.excess * (penalty - point.mult)
    if affine is not None:
        low -= second_order * affine.slack_low * affine.mult_low
        high -= second_order * affine.slack_high * affine.mult_high
        rows -= second_order * affine.slack * affine.mult
        excess += second_order * affine.excess * affine.mult
    return Targets(
        masks.low * low,
        masks.high * high,
        masks.inequality * rows,
        jnp.where(masks.elastic, excess, 0.0),
    )


def direction(
    layout: Layout,
    masks: Masks,
    point: Iterate,
    ev: Evaluation,
    factor: Factor,
    target: Targets,
) -> Iterate:
    """Solve for one right-hand side and recover slacks and multipliers."""
    lin, res, n = ev.lin, ev.residual, layout.n
    spare = jnp.where(masks.elastic, lin.penalty - point.mult, 1.0)
    wanted = (
        jnp.where(masks.equality, 0.0, target.rows / jnp.where(masks.equality, 1.0, point.mult))
        - jnp.where(masks.elastic, target.excess / spare, 0.0)
        - res.rows
    )
    shift = (
        -(target.low - point.mult_low * res.low) / point.slack_low
        + (target.high - point.mult_high * res.high) / point.slack_high
    )
    rest = jnp.concatenate([shift[:, n:] + res.stationarity, -wanted], axis=1)
    dx, du = solve_stages(factor, shift[:, :n], rest, res.defect, jnp.zeros(n))
    du, mult = du[:, : layout.m], du[:, layout.m :]
    dw = jnp.concatenate([dx, du], axis=1)
    slope = jnp.einsum("tka,ta->tk", lin.jacobian, dw)
    slack_low = masks.low * (dw + res.low)
    slack_high = masks.high * (res.high - dw)
    excess = jnp.where(masks.elastic, (target.excess + point.excess * mult) / spare, 0.0)
    return Iterate(
        dx,
        du,
        slack_low,
        slack_high,
        (target.low - point.mult_low * slack_low) / point.slack_low,
        (target.high - point.mult_high * slack_high) / point.slack_high,
        masks.inequality * (slope + excess + res.rows),
        excess,
        mult,
    )


def step_lengths(
    masks: Masks, point: Iterate, penalty: Array, step: Iterate, fraction: Scalar
) -> tuple[Scalar, Scalar]:
    """Largest primal and dual steps in (0, 1] that keep slacks and multipliers positive."""

    def longest(value: Array, change: Array, mask: Array) -> Scalar:
        limit = jnp.where(
            (mask > 0) & (change < 0), -value / jnp.where(change < 0, change, -1), 1e9
        )
        return jnp.min(limit, initial=1e9)

    primal = jnp.stack(
        [
            longest(point.slack_low, step.slack_low, masks.low),
            longest(point.slack_high, step.slack_high, masks.high),
            longest(point.slack, step.slack, masks.inequality),
            longest(point.excess, step.excess, masks.elastic),
        ]
    ).min()
    dual = jnp.stack(
        [
            longest(point.mult_low, step.mult_low, masks.low),
            longest(point.mult_high, step.mult_high, masks.high),
            longest(point.mult, step.mult, masks.inequality),
            longest(penalty - point.mult, -step.mult, masks.elastic),
        ]
    ).min()
    return jnp.minimum(1.0, fraction * primal), jnp.minimum(1.0, fraction * dual)


def advance(point: Iterate, step: Iterate, primal: Scalar, dual: Scalar) -> Iterate:
    """`point + length * step`, primal and dual parts with their own lengths."""
    lengths = Iterate(primal, primal, primal, primal, dual, dual, primal, primal, dual)
    return Iterate(*(p + a * s for p, a, s in zip(point, lengths, step, strict=True)))


def average_product(masks: Masks, point: Iterate, penalty: Array) -> Scalar:
    """Mean of `slack * multiplier` over all inequalities (0 when there are none)."""
    products = (
        jnp.sum(masks.low * point.slack_low * point.mult_low)
        + jnp.sum(masks.high * point.slack_high * point.mult_high)
        + jnp.sum(masks.inequality * point.slack * point.mult)
        + jnp.sum(jnp.where(masks.elastic, point.excess * (penalty - point.mult), 0.0))
    )
    horizon = point.x.shape[0]
    count = (
        jnp.sum(masks.low)
        + jnp.sum(masks.high)
        + horizon * (jnp.sum(masks.inequality) + jnp.sum(masks.elastic))
    )
    return products / jnp.maximum(count, 1.0)


def newton_step(
    layout: Layout, masks: Masks, point: Iterate, ev: Evaluation, options: Options
) -> Iterate:
    """The next point: Mehrotra's predictor, then its corrector."""
    penalty = ev.lin.penalty
    factor = factorise(stage_system(layout, masks, point, ev))

    def solve(target: Targets) -> Iterate:
        return direction(layout, masks, point, ev, factor, target)

    affine = solve(targets(masks, point, penalty, jnp.zeros(())))
    primal, dual = step_lengths(masks, point, penalty, affine, jnp.ones(()))
    average = average_product(masks, point, penalty)
    predicted = average_product(masks, advance(point, affine, primal, dual), penalty)
    sigma = jnp.clip(predicted / jnp.maximum(average, 1e-300), 0.0, 1.0) ** 3
    # Complementarity must not run ahead of stationarity: on a path too narrow to follow the
    # curvature of the others' constraints, steps are cut to nothing.
    wide = jnp.minimum(average, 1e-2 * ev.error)
    barrier = jnp.maximum(jnp.maximum(sigma * average, wide), options.barrier)
    # At the end of the path plain Newton converges quadratically; the correction would not.
    second_order = jnp.where(average > 10.0 * options.barrier, 1.0, 0.0)
    step = solve(targets(masks, point, penalty, barrier, affine, second_order))
    fraction = jnp.maximum(0.99, 1.0 - average)
    primal, dual = step_lengths(masks, point, penalty, step, fraction)
    return advance(point, step, primal, dual)


def is_finite(point: Iterate, ev: Evaluation) -> Bool[Array, ""]:
    """Whether nothing overflowed."""
    return jnp.stack([jnp.all(jnp.isfinite(v)) for v in (ev.error, *point)]).all()


def hopeless(point: Iterate, ev: Evaluation) -> Bool[Array, ""]:
    """Multipliers run away while constraints stay unmet: there is no feasible point near."""
    return (largest_multiplier(point) > RUNAWAY_MULTIPLIER) & (violation(ev) > VIOLATED)


def iterate(
    layout: Layout,
    parameters: Parameters,
    start: Iterate,
    options: Options,
    exact_below: Scalar | float,
) -> tuple[Iterate, Evaluation, Int[Array, ""]]:
    """Run the method from `start`; the caller reads success off the evaluation's errors.

    The point is the last finite one; the error is infinite where the next one was not finite.
    """
    masks = masks_of(layout)

    def body(loop: Loop) -> Loop:
        point = newton_step(layout, masks, loop.point, loop.evaluation, options)
        # The next linearisation's curvature is chosen by the present error: one evaluation a step.
        convexity = jnp.where(loop.evaluation.error < exact_below, 0.0, 1.0)
        ev = evaluate(layout, masks, point, parameters, convexity, options)
        finite = is_finite(point, ev)
        # A step that overflowed is not taken: what is returned says how far the method came.
        point, ev = jax.tree.map(
            lambda new, old: jnp.where(finite, new, old),
            (point, ev),
            (loop.point, loop.evaluation),
        )
        return Loop(point, ev, loop.iteration + 1, finite)

    def unfinished(loop: Loop) -> Bool[Array, ""]:
        return (
            ~converged(loop.evaluation, options)
            & ~hopeless(loop.point, loop.evaluation)
            & loop.finite
            & (loop.iteration < options.max_iterations)
        )

    first = evaluate(layout, masks, start, parameters, jnp.ones(()), options)
    loop = jax.lax.while_loop(
        unfinished, body, Loop(start, first, jnp.zeros((), int), jnp.isfinite(first.error))
    )
    error = jnp.where(loop.finite, loop.evaluation.error, jnp.inf)
    return loop.point, loop.evaluation._replace(error=error), loop.iteration


def start_point(
    layout: Layout, parameters: Parameters, x: Array, u: Array, options: Options
) -> Iterate:
    """Cold start around a trajectory: positive slacks and multipliers on the central path."""
    masks = masks_of(layout)
    w = jnp.concatenate([x, u], axis=1)
    penalty = layout.penalties(parameters.theta).astype(x.dtype)
    stages = jnp.arange(1, layout.game.horizon + 1)
    values = jax.vmap(lambda t, v: layout.constraint_values(t, v, parameters.theta))(stages, w)
    barrier = options.start_barrier

    def pair(gap: Array, mask: Array) -> tuple[Array, Array]:
        slack = jnp.where(mask > 0, jnp.maximum(gap, 0.1), 1.0)
        return slack, mask * barrier / slack

    slack_low, mult_low = pair(w - masks.lower, masks.low)
    slack_high, mult_high = pair(masks.upper - w, masks.high)
    slack, mult = pair(values, jnp.broadcast_to(masks.inequality, values.shape))
    mult = jnp.where(masks.elastic, jnp.minimum(mult, 0.5 * penalty), mult)
    excess = jnp.where(masks.elastic, barrier / jnp.where(masks.elastic, penalty - mult, 1.0), 0.0)
    return Iterate(x, u, slack_low, slack_high, mult_low, mult_high, slack, excess, mult)
