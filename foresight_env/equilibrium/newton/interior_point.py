"""Primal-dual interior-point method for a game's mixed complementarity problem.

Every inequality `g >= 0` gets a slack and a multiplier with `slack * multiplier = barrier`;
Newton's method follows that path down to `SolverOptions.barrier` with Mehrotra's predictor and corrector
(Nocedal and Wright, "Numerical Optimization", 2nd ed., algorithm 14.3). What each iteration solves
has the size of one stage (modules `newton_system`, `stagewise`).

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

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import Pairs, count, pairs_of
from foresight_env.equilibrium.conditions.residual import (
    VIOLATED,
    Evaluation,
    evaluate,
    largest_multiplier,
    violation,
)
from foresight_env.equilibrium.conditions.rollout import feedback_rollout
from foresight_env.equilibrium.linear_algebra.stagewise import Factor, factorise
from foresight_env.equilibrium.newton.convexification import next_convexity, used_convexity
from foresight_env.equilibrium.newton.newton_system import (
    Linear,
    direction,
    eliminate_pairs,
    fischer_burmeister,
    has_condensed_rows,
    on_the_path,
    stage_system,
)
from foresight_env.games.types import Scalar


@dataclass(frozen=True)
class SolverOptions:
    """Settings of the forward solver; the defaults are those that the benchmarks measured."""

    tolerance: float = 1e-8
    """Largest entry of the scaled KKT residual at which a game counts as solved."""
    max_iterations: int = 80
    """Newton steps per attempt along the path where all dynamics are linear."""
    nonlinear_iterations: int = 200
    """The same where some are not: a short-sighted driver's stages settle one after another."""
    barrier: float = 1e-9
    """Complementarity product at the solution: the solution is a smooth function of parameters."""
    barrier_schedule: tuple[float, ...] = (0.1, 1.0, 100.0, 10.0)
    """Complementarity product at the start of each attempt along the path. The first attempt begins
    at the start itself, later ones at controls nudged off any symmetry and with the exact curvature
    used earlier. A narrow path stays near the equilibrium that it begins at, and suits cars that
    just fit between others; costs in the hundreds want a wide one. From a similar game's solution
    there are two attempts before them (module `attempts`)."""
    exact_below: float = 1e-2
    """Residual below which all curvature is used exactly."""
    local_steps: int = 10
    """Local steps from a similar game's solution, before the path is followed from there."""
    resumed_steps: int = 45
    """Newton steps of the attempt along the path that begins at a similar game's solution. Of 319
    such at crossings, junctions and drives 298 arrived within 45, and 13 more within 200."""
    trial_steps: int = 25
    """Newton steps of the one attempt along the path that a fit's trial step gets: parameters whose
    game is not solved soon are no step to take."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "barrier_schedule", tuple(self.barrier_schedule))
        if not self.barrier_schedule or not all(b > 0.0 for b in self.barrier_schedule):
            raise ValueError(
                f"barrier_schedule: is {self.barrier_schedule}; expected positive numbers, at least one"
            )


class Accuracy(NamedTuple):
    """Where an iteration ends."""

    barrier: Scalar | float
    """Complementarity product."""
    tolerance: Scalar | float
    """Largest entry of the scaled KKT residual."""


def accuracy_of(options: SolverOptions, barrier: Scalar | None) -> Accuracy:
    """The solution, or (`barrier` given) the smooth approximation of that product.

    An approximation is met no more closely than it deserves.
    """
    if barrier is None:
        return Accuracy(options.barrier, options.tolerance)
    return Accuracy(barrier, jnp.maximum(options.tolerance, 1e-3 * barrier))


class Loop(NamedTuple):
    """State of the iteration."""

    point: Iterate
    evaluation: Evaluation
    iteration: Int[Array, ""]
    finite: Bool[Array, ""]
    convexity: Float[Array, ""]


RUNAWAY_MULTIPLIER = 1e10
"""Multiplier of an unmet constraint at which the method gives up, before numbers overflow."""


LOCAL_TRIAL = 3
"""Local steps after which the residual must not be above that of their start. Of 543 warm solves of
crossings, junctions and drives 214 were above it then, and 5 of these still arrived within ten
steps; of the 329 others 226 did."""


def astray(
    local: Bool[Array, ""] | None,
    iteration: Int[Array, ""],
    error: Scalar,
    begun: Scalar,
) -> Bool[Array, ""]:
    """Whether local steps lead away from where they began, at a residual of `begun`."""
    if local is None:
        return jnp.zeros((), bool)
    return local & (iteration >= LOCAL_TRIAL) & (error > begun)


def converged(ev: Evaluation, accuracy: Accuracy) -> Bool[Array, ""]:
    """Whether the perturbed KKT conditions hold, complementarity to a hundredth of the barrier.

    So narrow a path makes the solution a function of the parameters alone, start or no start.
    """
    return (ev.error <= accuracy.tolerance) & (ev.complementarity <= 0.01 * accuracy.barrier)


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
    convexity: Scalar,
) -> tuple[Iterate, Scalar]:
    """The next point on the way to products of `end`, and the part of the step that was taken.

    Mehrotra's predictor, then its corrector; or one full local step.

    `local` None: there are no local steps in this program.
    """

    def on_path() -> Linear:
        return on_the_path(pairs, point, jnp.zeros(()))

    def beside_path() -> Linear:
        return fischer_burmeister(pairs, point, end)

    linear = on_path() if local is None else jax.lax.cond(local, beside_path, on_path)
    eliminated = eliminate_pairs(layout, pairs, linear)
    condensed = has_condensed_rows(layout)
    system = stage_system(layout, point, ev, eliminated, convexity, condensed=condensed)
    factor = factorise(system, layout.equal_sizes)
    first = direction(layout, pairs, ev, factor, eliminated, linear, condensed=condensed)

    def along_the_path() -> tuple[Iterate, Scalar]:
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
        ahead = advance(point, step, primal, dual)
        return driven(layout, ev, factor, ahead, point, step, primal), primal

    if local is None:
        return along_the_path()
    one = jnp.ones(())
    return jax.lax.cond(local, lambda: (advance(point, first, one, one), one), along_the_path)


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
    options: SolverOptions,
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
        before = loop.evaluation
        # The next linearisation's curvature is chosen by the present error: one evaluation a step.
        used = used_convexity(loop.convexity, before.error, exact_below)
        point, taken = newton_step(layout, pairs, loop.point, before, accuracy.barrier, local, used)
        ev = evaluate(layout, pairs, point, parameters, used, accuracy.barrier)
        convexity = next_convexity(layout, loop.convexity, before.error, ev.error, taken)
        finite = is_finite(point, ev)
        # A step that overflowed is not taken: what is returned says how far the method came.
        point, ev = jax.tree.map(
            lambda new, old: jnp.where(finite, new, old),
            (point, ev),
            (loop.point, before),
        )
        return Loop(point, ev, loop.iteration + 1, finite, convexity)

    def unfinished(loop: Loop) -> Bool[Array, ""]:
        return (
            ~converged(loop.evaluation, accuracy)
            & ~hopeless(layout, loop.point, loop.evaluation)
            & ~astray(local, loop.iteration, loop.evaluation.error, first.error)
            & loop.finite
            & (loop.iteration < limit)
        )

    convexity = jnp.where(exact_below == jnp.inf, 0.0, 1.0)
    first = evaluate(layout, pairs, start, parameters, convexity, accuracy.barrier)
    begin = Loop(start, first, jnp.zeros((), int), is_finite(start, first), convexity)
    loop = jax.lax.while_loop(unfinished, body, begin)
    error = jnp.where(loop.finite, loop.evaluation.error, jnp.inf)
    return loop.point, loop.evaluation._replace(error=error), loop.iteration
