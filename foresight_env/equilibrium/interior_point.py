"""Primal-dual interior-point method for a game's mixed complementarity problem.

Every inequality `g >= 0` gets a slack and a multiplier with `slack * multiplier = barrier`;
Newton's method follows that path down to `Options.barrier` with Mehrotra's predictor and corrector
(Nocedal and Wright, "Numerical Optimization", 2nd ed., algorithm 14.3). What each iteration solves
has the size of one stage (module `stagewise`).

Near a solution that is known, of a similar game say, the path is left out: *local* steps are plain
Newton steps on `slack + multiplier - sqrt(slack^2 + multiplier^2 + 2 barrier) = 0`, whose solutions
are the same points but which may be entered from anywhere (Fischer, Optimization 24, 1992; smoothed
as by Kanzow, SIAM J. Matrix Anal. Appl. 17, 1996).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.curvature import CONVEX_ABOVE, dynamics_hessian
from foresight_env.equilibrium.kkt import (
    Iterate,
    Linearisation,
    Parameters,
    costates,
    linearise,
    stationarity,
)
from foresight_env.equilibrium.layout import Layout
from foresight_env.equilibrium.pairs import (
    Pairs,
    Parts,
    count,
    distances_to_bounds,
    join,
    pairs_of,
    split,
)
from foresight_env.equilibrium.rollout import feedback_rollout
from foresight_env.equilibrium.stagewise import Factor, StageSystem, factorise, solve_stages
from foresight_env.games.types import Scalar


@dataclass(frozen=True)
class Options:
    """Settings of the forward solver; the defaults are those that the benchmarks measured."""

    tolerance: float = 1e-8
    """Largest entry of the scaled KKT residual at which a game counts as solved."""
    max_iterations: int = 80
    """Newton steps per attempt along the path where all dynamics are linear."""
    nonlinear_iterations: int = 200
    """The same where some are not: a short-sighted driver's stages settle one after another."""
    barrier: float = 1e-9
    """Complementarity product at the solution: the solution is a smooth function of parameters."""
    start_barriers: tuple[float, ...] = (0.1, 1.0, 100.0)
    """Complementarity product at the start of each attempt along the path. The first attempt begins
    at the start itself (from a similar game's solution, with that one's products), later ones at
    controls nudged off any symmetry and with the exact curvature used earlier. A narrow path stays
    near the equilibrium that it begins at, and suits cars that just fit between others; costs in
    the hundreds want a wide one."""
    exact_below: float = 1e-2
    """Residual below which curvature of proximity terms and constraints is used exactly."""
    local_steps: int = 10
    """Local steps from a similar game's solution, before the path is followed from there."""
    trial_steps: int = 25
    """Newton steps of the one attempt along the path that a fit's trial step gets: parameters whose
    game is not solved soon are no step to take."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "start_barriers", tuple(self.start_barriers))
        if not self.start_barriers or not all(b > 0.0 for b in self.start_barriers):
            raise ValueError(
                f"start_barriers: is {self.start_barriers}; expected positive numbers, at least one"
            )


class Accuracy(NamedTuple):
    """Where an iteration ends."""

    barrier: Scalar | float
    """Complementarity product."""
    tolerance: Scalar | float
    """Largest entry of the scaled KKT residual."""


def has_condensed_rows(layout: Layout) -> bool:
    """Whether Newton steps eliminate row multipliers: many rows, and each one player's own.

    Shared rows stay among the unknowns: of six walkers with a shared constraint 28 % instead of
    94 % were solved without them.
    """
    own = not layout.game.shared and not layout.equality.any()
    return own and len(layout.rows) > CONDENSED_ROWS


def step_limit(layout: Layout, options: Options) -> int:
    """Newton steps that an attempt along the path may take."""
    return options.max_iterations if layout.linear else options.nonlinear_iterations


def accuracy_of(options: Options, barrier: Scalar | None) -> Accuracy:
    """The solution, or (`barrier` given) the smooth approximation of that product.

    An approximation is met no more closely than it deserves.
    """
    if barrier is None:
        return Accuracy(options.barrier, options.tolerance)
    return Accuracy(barrier, jnp.maximum(options.tolerance, 1e-3 * barrier))


class Residual(NamedTuple):
    """Left-hand sides of the perturbed KKT conditions that a Newton step drives to zero."""

    stationarity: Float[Array, "T m"]
    defect: Float[Array, "T n"]
    low: Float[Array, "T w"]
    high: Float[Array, "T w"]
    rows: Float[Array, "T K"]


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
CONDENSED_ROWS = 8
"""Constraint rows of a stage above which Newton steps eliminate their multipliers."""
RUNAWAY_MULTIPLIER = 1e10
"""Multiplier of an unmet constraint at which the method gives up, before numbers overflow."""


def evaluate(
    layout: Layout,
    pairs: Pairs,
    point: Iterate,
    parameters: Parameters,
    convexity: Scalar,
    barrier: Scalar | float,
) -> Evaluation:
    """Derivatives and residuals at `point`, with products of `barrier` in mind."""
    lin = linearise(layout, point, parameters, convexity)
    q = costates(lin, layout.n)
    above, below = distances_to_bounds(layout, pairs, jnp.concatenate([point.x, point.u], axis=1))
    exists, slack = split(layout, pairs.exists), split(layout, point.slack)
    residual = Residual(
        stationarity(lin, q),
        lin.defect,
        jnp.where(exists.low, above - slack.low, 0.0),
        jnp.where(exists.high, below - slack.high, 0.0),
        lin.values
        - jnp.where(pairs.equality, 0.0, slack.row)
        + jnp.where(pairs.elastic, slack.excess, 0.0),
    )
    # Negative slacks and multipliers, which local steps pass through, solve nothing.
    products = jnp.maximum(point.slack, 0.0) * jnp.maximum(point.mult, 0.0)
    off_path = jnp.where(pairs.exists, barrier - products, 0.0)
    return Evaluation(
        lin, q, residual, _largest(jnp.concatenate(residual, axis=1)), _largest(off_path)
    )


def converged(ev: Evaluation, accuracy: Accuracy) -> Bool[Array, ""]:
    """Whether the perturbed KKT conditions hold, complementarity to a hundredth of the barrier.

    So narrow a path makes the solution a function of the parameters alone, start or no start.
    """
    return (ev.error <= accuracy.tolerance) & (ev.complementarity <= 0.01 * accuracy.barrier)


def violation(ev: Evaluation) -> Scalar:
    """Largest violation of a bound or a constraint."""
    residual = ev.residual
    return _largest(jnp.concatenate([residual.low, residual.high, residual.rows], axis=1))


def largest_multiplier(layout: Layout, point: Iterate) -> Scalar:
    """Largest multiplier of a bound or a constraint; what is left of penalties does not count."""
    mult = split(layout, point.mult)
    return _largest(jnp.concatenate([mult.low, mult.high, mult.row], axis=1))


def _largest(values: Array) -> Scalar:
    return jnp.max(jnp.abs(values), initial=0.0)


class Linear(NamedTuple):
    """Complementarity, linear in the step: `slope d_slack + own d_mult = target`, per pair."""

    slope: Float[Array, "T P"]
    own: Float[Array, "T P"]
    target: Float[Array, "T P"]


def on_the_path(pairs: Pairs, point: Iterate, wanted: Array) -> Linear:
    """`slack * multiplier` becomes `wanted`, to first order."""
    target = jnp.where(pairs.exists, wanted - point.slack * point.mult, 0.0)
    return Linear(point.mult, point.slack, target)


def fischer_burmeister(pairs: Pairs, point: Iterate, barrier: Scalar | float) -> Linear:
    """Newton on `slack + mult - r = 0` with `r = sqrt(slack^2 + mult^2 + 2 barrier)`.

    Differences of nearly equal numbers are written as quotients.
    """
    s, m = point.slack, point.mult
    r = jnp.sqrt(s**2 + m**2 + 2.0 * barrier)

    def rest(value: Array, other: Array) -> Array:  # (r - value) / r
        product = (other**2 + 2.0 * barrier) / (r * (r + jnp.abs(value)))
        return jnp.where(value > 0.0, product, (r - value) / r)

    total = s + m
    gap = jnp.where(total > 0.0, 2.0 * (barrier - s * m) / (r + jnp.abs(total)), r - total)
    return Linear(
        jnp.where(pairs.exists, rest(s, m), 0.0),
        jnp.where(pairs.exists, rest(m, s), 1.0),
        jnp.where(pairs.exists, gap, 0.0),
    )


class Eliminated(NamedTuple):
    """What remains of `Linear` once slacks and multipliers are eliminated from the stage."""

    ratios: Parts
    """Slopes over own coefficients of bounds; of rows and excess, own coefficients over slopes."""
    softness: Float[Array, "T K"]
    """`-d g / d mult` of each row."""


def eliminate_pairs(layout: Layout, pairs: Pairs, linear: Linear) -> Eliminated:
    """Coefficients that the stage matrices and every right-hand side share."""
    slope, own = split(layout, linear.slope), split(layout, linear.own)
    excess = jnp.where(pairs.elastic, own.excess / jnp.where(pairs.elastic, slope.excess, 1.0), 0.0)
    row = own.row / jnp.where(pairs.equality, 1.0, slope.row)
    softness = jnp.where(pairs.equality, EQUALITY_REGULARISATION, row + excess)
    return Eliminated(Parts(slope.low / own.low, slope.high / own.high, excess, row), softness)


def stage_system(
    layout: Layout,
    point: Iterate,
    ev: Evaluation,
    eliminated: Eliminated,
    convex: Bool[Array, ""] | None = None,
    *,
    condensed: bool = False,
) -> StageSystem:
    """The linear system with slacks and bound multipliers eliminated.

    `convex`: whether to use the positive part of the dynamics' curvature only (None: no);
    `condensed`: whether row multipliers are eliminated too.
    """
    lin = ev.lin
    diagonal = eliminated.ratios.low + eliminated.ratios.high
    eye = jnp.eye(diagonal.shape[1], dtype=bool)
    hessian = lin.hessian + jnp.where(eye, diagonal[:, :, None], 0.0)
    curvature = dynamics_hessian(layout, lin.previous, point.u, ev.q, convex)
    b = lin.b
    if condensed:
        weighted = lin.jacobian / eliminated.softness[:, :, None]
        hessian = hessian + jnp.einsum("tka,tkb->tab", lin.share * lin.jacobian, weighted)
    elif layout.rows:
        # Row multipliers stay among a stage's unknowns, beside its controls. Eliminating them too
        # would put weights of 1e11 on positions and lose the game's own curvature to rounding.
        soft = eliminated.softness
        softness = jnp.where(jnp.eye(soft.shape[1], dtype=bool), soft[:, :, None], 0.0)
        pull = -jnp.swapaxes(lin.share * lin.jacobian, 1, 2)
        hessian = jnp.concatenate(
            [
                jnp.concatenate([hessian, pull], axis=2),
                jnp.concatenate([lin.jacobian, softness], axis=2),
            ],
            axis=1,
        )
        extra = len(layout.rows)
        if curvature is not None:
            curvature = jnp.pad(curvature, ((0, 0), (0, extra), (0, extra)))
        b = jnp.concatenate([b, jnp.zeros((*b.shape[:2], extra), b.dtype)], axis=2)
    return StageSystem(hessian, curvature, lin.a, b, lin.rho)


def direction(
    layout: Layout,
    pairs: Pairs,
    ev: Evaluation,
    factor: Factor,
    eliminated: Eliminated,
    linear: Linear,
    *,
    condensed: bool = False,
) -> Iterate:
    """Solve for one right-hand side and recover slacks and multipliers."""
    lin, res, n = ev.lin, ev.residual, layout.n
    slope, own = split(layout, linear.slope), split(layout, linear.own)
    target, known = split(layout, linear.target), eliminated.ratios
    # The constant parts of each pair's step, were nothing else to move.
    low = target.low / own.low - known.low * res.low
    high = target.high / own.high - known.high * res.high
    excess = jnp.where(
        pairs.elastic, target.excess / jnp.where(pairs.elastic, slope.excess, 1.0), 0.0
    )
    row = jnp.where(pairs.equality, 0.0, target.row / jnp.where(pairs.equality, 1.0, slope.row))
    wanted = row - excess - res.rows
    shift = high - low
    stationary = shift[:, n:] + res.stationarity
    if condensed:
        soft = eliminated.softness
        pull = jnp.einsum("tka,tk->ta", lin.share * lin.jacobian, wanted / soft)
        dx, du, _ = solve_stages(
            factor,
            shift[:, :n] - pull[:, :n],
            stationary - pull[:, n:],
            res.defect,
            jnp.zeros(n),
            layout.m,
        )
        dw = jnp.concatenate([dx, du], axis=1)
        mult = (wanted - jnp.sum(lin.jacobian * dw[:, None, :], axis=2)) / soft
    else:
        rest = jnp.concatenate([stationary, -wanted], axis=1)
        dx, du, mult = solve_stages(factor, shift[:, :n], rest, res.defect, jnp.zeros(n), layout.m)
        dw = jnp.concatenate([dx, du], axis=1)
    exists = split(layout, pairs.exists)
    excess = excess + known.excess * mult
    reached = jnp.sum(lin.jacobian * dw[:, None, :], axis=2) + excess + res.rows
    slack = Parts(
        jnp.where(exists.low, dw + res.low, 0.0),
        jnp.where(exists.high, res.high - dw, 0.0),
        excess,
        jnp.where(pairs.equality, 0.0, reached),
    )
    mults = Parts(
        low - known.low * dw,
        high + known.high * dw,
        jnp.where(pairs.elastic, -mult, 0.0),
        mult,
    )
    return Iterate(dx, du, join(slack), join(mults))


def step_lengths(
    pairs: Pairs, point: Iterate, step: Iterate, fraction: Scalar | float
) -> tuple[Scalar, Scalar]:
    """Largest primal and dual steps in (0, 1] that keep slacks and multipliers positive."""

    def longest(value: Array, change: Array) -> Scalar:
        # The fastest relative decrease; a quotient by the value needs no case for its sign.
        rate = jnp.max(jnp.where(pairs.exists, -change / value, 0.0), initial=0.0)
        return jnp.minimum(1.0, fraction / jnp.maximum(rate, 1e-9))

    return longest(point.slack, step.slack), longest(point.mult, step.mult)


def advance(point: Iterate, step: Iterate, primal: Scalar, dual: Scalar) -> Iterate:
    """`point + length * step`, primal and dual parts with their own lengths."""
    lengths = Iterate(primal, primal, primal, dual)
    return Iterate(*(p + a * s for p, a, s in zip(point, lengths, step, strict=True)))


def driven(
    layout: Layout,
    ev: Evaluation,
    factor: Factor,
    ahead: Iterate,
    point: Iterate,
    step: Iterate,
    length: Scalar,
) -> Iterate:
    """The next point with states and controls from driving the step, where dynamics are nonlinear.

    Where that overflows, the straight step's.
    """
    if layout.linear:
        return ahead
    x, u = feedback_rollout(
        layout, ev.lin.previous, point.u, step.x, step.u, factor.gain[:, : layout.m], length
    )
    finite = jnp.isfinite(jnp.sum(x))
    return ahead._replace(x=jnp.where(finite, x, ahead.x), u=jnp.where(finite, u, ahead.u))


def average_product(pairs: Pairs, slack: Array, mult: Array) -> Scalar:
    """Mean of `slack * multiplier` over all pairs (0 when there are none)."""
    return jnp.sum(jnp.where(pairs.exists, slack * mult, 0.0)) / jnp.maximum(count(pairs), 1.0)


def newton_step(
    layout: Layout,
    pairs: Pairs,
    point: Iterate,
    ev: Evaluation,
    end: Scalar | float,
    local: Bool[Array, ""] | None,
) -> Iterate:
    """The next point on the way to products of `end`.

    Mehrotra's predictor, then its corrector; or one full local step.

    `local` None: there are no local steps in this program.
    """

    def on_path() -> Linear:
        return on_the_path(pairs, point, jnp.zeros(()))

    def beside_path() -> Linear:
        return fischer_burmeister(pairs, point, end)

    linear = on_path() if local is None else jax.lax.cond(local, beside_path, on_path)
    eliminated = eliminate_pairs(layout, pairs, linear)
    convex = ev.error > CONVEX_ABOVE
    if local is not None:
        convex &= ~local
    condensed = has_condensed_rows(layout)
    system = stage_system(layout, point, ev, eliminated, convex, condensed=condensed)
    factor = factorise(system)
    first = direction(layout, pairs, ev, factor, eliminated, linear, condensed=condensed)

    def along_the_path() -> Iterate:
        primal, dual = step_lengths(pairs, point, first, 1.0)
        average = average_product(pairs, point.slack, point.mult)
        predicted = average_product(
            pairs, point.slack + primal * first.slack, point.mult + dual * first.mult
        )
        sigma = jnp.clip(predicted / jnp.maximum(average, 1e-300), 0.0, 1.0) ** 3
        # Complementarity must not run ahead of stationarity: on a path too narrow to follow the
        # curvature of the others' constraints, steps are cut to nothing.
        wide = jnp.minimum(average, 1e-2 * ev.error)
        barrier = jnp.maximum(jnp.maximum(sigma * average, wide), end)
        # At the end of the path plain Newton converges quadratically; the correction would not.
        second_order = jnp.where(average > 10.0 * end, 1.0, 0.0)
        wanted = barrier - second_order * first.slack * first.mult
        target = on_the_path(pairs, point, wanted)
        step = direction(layout, pairs, ev, factor, eliminated, target, condensed=condensed)
        fraction = jnp.maximum(0.99, 1.0 - average)
        primal, dual = step_lengths(pairs, point, step, fraction)
        return driven(layout, ev, factor, advance(point, step, primal, dual), point, step, primal)

    if local is None:
        return along_the_path()
    one = jnp.ones(())
    return jax.lax.cond(local, lambda: advance(point, first, one, one), along_the_path)


def is_finite(point: Iterate, ev: Evaluation) -> Bool[Array, ""]:
    """Whether nothing overflowed."""
    return jnp.isfinite(ev.error + ev.complementarity + jnp.sum(point.x) + jnp.sum(point.u))


def hopeless(layout: Layout, point: Iterate, ev: Evaluation) -> Bool[Array, ""]:
    """Multipliers run away while constraints stay unmet: there is no feasible point near."""
    return (largest_multiplier(layout, point) > RUNAWAY_MULTIPLIER) & (violation(ev) > VIOLATED)


def iterate(
    layout: Layout,
    parameters: Parameters,
    start: Iterate,
    options: Options,
    accuracy: Accuracy,
    exact_below: Scalar | float,
    limit: Int[Array, ""] | int,
    local: Bool[Array, ""] | None,
) -> tuple[Iterate, Evaluation, Int[Array, ""]]:
    """Run the method from `start`, at most `limit` steps along the path.

    The caller reads success off the evaluation's errors.

    The point is the last finite one; the error is infinite where the next one was not finite.
    """
    pairs = pairs_of(layout)
    limit = jnp.asarray(limit)
    if local is not None:
        limit = jnp.where(local, options.local_steps, limit)
        exact_below = jnp.where(local, jnp.inf, exact_below)

    def body(loop: Loop) -> Loop:
        point = newton_step(layout, pairs, loop.point, loop.evaluation, accuracy.barrier, local)
        # The next linearisation's curvature is chosen by the present error: one evaluation a step.
        convexity = jnp.where(loop.evaluation.error < exact_below, 0.0, 1.0)
        ev = evaluate(layout, pairs, point, parameters, convexity, accuracy.barrier)
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
            ~converged(loop.evaluation, accuracy)
            & ~hopeless(layout, loop.point, loop.evaluation)
            & loop.finite
            & (loop.iteration < limit)
        )

    convexity = jnp.where(exact_below == jnp.inf, 0.0, 1.0)
    first = evaluate(layout, pairs, start, parameters, convexity, accuracy.barrier)
    loop = jax.lax.while_loop(
        unfinished, body, Loop(start, first, jnp.zeros((), int), is_finite(start, first))
    )
    error = jnp.where(loop.finite, loop.evaluation.error, jnp.inf)
    return loop.point, loop.evaluation._replace(error=error), loop.iteration
