"""One phase of the solver as pure functions: `init_phase`, `step_phase`, `phase_ended`.

Every driver iterates these: one game at a time (module `implicit`), or many in lockstep (module
`batch.slots`); `init_or_step_phase` is both of them in one program.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import (
    Evaluation,
    evaluate,
    largest_multiplier,
    violation,
)
from foresight_env.equilibrium.newton.convexification import next_weight, used_weight
from foresight_env.equilibrium.newton.damping import Damped, is_rejected, next_damped, undamped
from foresight_env.equilibrium.newton.interior_point import newton_step
from foresight_env.equilibrium.newton.schedule import PhaseRules
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.types import Scalar


class Accuracy(NamedTuple):
    """Accuracy at which an iteration ends."""

    barrier: Scalar | float
    """Complementarity product."""
    tolerance: Scalar | float
    """Largest entry of the scaled KKT residual."""
    width: float
    """Largest deviation of products from `barrier`, relative to it."""


def accuracy_of(options: SolverOptions, barrier: Scalar | None) -> Accuracy:
    """Return the accuracy of the solution or, with a `barrier`, of a smoothed approximation."""
    if barrier is None:
        return Accuracy(options.barrier, options.tolerance, options.path.end_width)
    tolerance = jnp.maximum(options.tolerance, options.path.smoothed_tolerance * barrier)
    return Accuracy(barrier, tolerance, options.path.end_width)


class PhaseState(NamedTuple):
    """State of the iteration."""

    point: Iterate
    """The last point that was accepted, at which everything was finite."""
    evaluation: Evaluation
    """Residual and linearisation there."""
    first_error: Scalar
    """Residual where the phase began."""
    iteration: Int[Array, ""]
    finite: Bool[Array, ""]
    """False once a step overflowed and is not repeated with more damping, which ends the phase."""
    weight: Float[Array, ""]
    """Convexification weight."""
    used: Float[Array, ""]
    """The weight that the evaluation was made with; 0: all curvature is in it."""
    damped: Damped
    """Of the next step."""

    @property
    def error(self) -> Scalar:
        """Largest entry of the scaled KKT residual; infinite where the last step overflowed."""
        return jnp.where(self.finite, self.evaluation.error, jnp.inf)


def converged(ev: Evaluation, accuracy: Accuracy) -> Bool[Array, ""]:
    """Return whether the perturbed KKT conditions hold."""
    near = ev.complementarity <= accuracy.width * accuracy.barrier
    return (ev.error <= accuracy.tolerance) & near


def succeeded(state: PhaseState, accuracy: Accuracy) -> Bool[Array, ""]:
    """Return whether the phase has found a solution."""
    return converged(state.evaluation._replace(error=state.error), accuracy)


def init_phase(
    layout: Layout,
    parameters: Parameters,
    start: Iterate,
    rules: PhaseRules,
    accuracy: Accuracy,
) -> PhaseState:
    """Return the state at the beginning of a phase."""
    weight = _first_weight(rules)
    first = evaluate(layout, pairs_of(layout), start, parameters, weight, accuracy.barrier)
    zero = jnp.zeros((), int)
    finite = _is_finite(start, first)
    return PhaseState(
        start, first, first.error, zero, finite, weight, weight, undamped(first.error)
    )


def step_phase(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    state: PhaseState,
    rules: PhaseRules,
    accuracy: Accuracy,
) -> PhaseState:
    """Return the state after one Newton step."""
    point, taken, used = _newton_point(layout, options, state, rules, accuracy)
    return _stepped(
        layout, options, parameters, state, point, taken, used, accuracy, rules.semismooth
    )


def init_or_step_phase(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    state: PhaseState,
    begins: Bool[Array, ""],
    repeats: Bool[Array, ""],
    begin: Callable[[], Iterate],
    rules: PhaseRules,
    accuracy: Accuracy,
) -> PhaseState:
    """Return `init_phase` where a phase `begins` (at the point that `begin` makes), else a step.

    Where it `repeats`, the point stays, and is evaluated with all curvature. All three need the
    residual and its derivatives at their point, most of a compiled program. Here that code exists
    once.
    """

    def first() -> tuple[Iterate, Scalar, Scalar]:
        return begin(), jnp.ones(()), _first_weight(rules)

    def next_one() -> tuple[Iterate, Scalar, Scalar]:
        return _newton_point(layout, options, state, rules, accuracy)

    def same() -> tuple[Iterate, Scalar, Scalar]:
        return state.point, jnp.ones(()), jnp.zeros(())

    way = jnp.where(begins, 0, jnp.where(repeats, 2, 1))
    point, taken, used = jax.lax.switch(way, (first, next_one, same))
    always = begins | repeats
    moved = _stepped(
        layout, options, parameters, state, point, taken, used, accuracy, rules.semismooth, always
    )
    iteration = jnp.where(begins, 0, jnp.where(repeats, state.iteration, moved.iteration))
    return moved._replace(
        first_error=jnp.where(begins, moved.evaluation.error, state.first_error),
        iteration=iteration,
        weight=jnp.where(begins, used, moved.weight),
        damped=jax.tree.map(
            lambda first, later: jnp.where(begins, first, later),
            undamped(moved.evaluation.error),
            moved.damped,
        ),
    )


def _first_weight(rules: PhaseRules) -> Scalar:
    """All non-convex curvature is left out at first, none of it in the semismooth phase."""
    # Not weakly typed, as Python's numbers are: `evaluate` would be traced again for those.
    return jnp.where(rules.exact_below == jnp.inf, jnp.zeros(()), jnp.ones(()))


def _newton_point(
    layout: Layout,
    options: SolverOptions,
    state: PhaseState,
    rules: PhaseRules,
    accuracy: Accuracy,
) -> tuple[Iterate, Scalar, Scalar]:
    """The next point, the part of the step that was taken, and the weight to linearise with."""
    # The next linearisation's curvature is chosen by the present error: one evaluation a step.
    before = state.evaluation
    used = used_weight(options.convexification, state.weight, before.error, rules.exact_below)
    point, taken = newton_step(
        layout,
        options,
        pairs_of(layout),
        state.point,
        before,
        accuracy.barrier,
        rules.semismooth,
        used,
        state.damped.value,
    )
    return point, taken, used


def _stepped(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    state: PhaseState,
    point: Iterate,
    taken: Scalar,
    used: Scalar,
    accuracy: Accuracy,
    semismooth: Bool[Array, ""] | None,
    always: Bool[Array, ""] | bool = False,
) -> PhaseState:
    """The state at `point`, or the last one where it is rejected and not taken `always`."""
    before = state.evaluation
    ev = evaluate(layout, pairs_of(layout), point, parameters, used, accuracy.barrier)
    schedule = options.convexification
    weight = next_weight(schedule, layout, state.weight, before.error, ev.error, taken)
    finite = _is_finite(point, ev)
    # A semismooth phase is short, and ends where its residual rises.
    rejectable = ~jnp.asarray(always) if semismooth is None else ~semismooth & ~always
    rejected = rejectable & is_rejected(options.damping, state.damped, ev.error)
    damped = next_damped(options.damping, state.damped, before.error, ev.error, rejected)
    if not layout.linear:
        weight = jnp.where(rejected, 1.0, weight)
    # A step that overflowed is not taken: the result shows how far the method came.
    kept = (finite & ~rejected) | always
    finite = finite | (rejected & (damped.value < options.damping.most))
    point, ev = jax.tree.map(
        lambda new, old: jnp.where(kept, new, old),
        (point, ev),
        (state.point, before),
    )
    used = jnp.where(kept, used, state.used)
    return PhaseState(
        point, ev, state.first_error, state.iteration + 1, finite, weight, used, damped
    )


def phase_ended(
    layout: Layout,
    options: SolverOptions,
    state: PhaseState,
    rules: PhaseRules,
    accuracy: Accuracy,
) -> Bool[Array, ""]:
    """Return whether the phase has converged, failed or used up its steps or its damping."""
    return (
        converged(state.evaluation, accuracy)
        | _runs_away(layout, options, state.point, state.evaluation)
        | _moves_away(options, state, rules)
        | ~state.finite
        | (state.damped.value >= options.damping.most)
        | (state.iteration >= rules.steps)
    )


def _moves_away(options: SolverOptions, state: PhaseState, rules: PhaseRules) -> Bool[Array, ""]:
    """Whether semismooth steps have raised the residual."""
    if rules.semismooth is None:
        return jnp.zeros((), bool)
    tried = state.iteration >= options.semismooth_trial
    return rules.semismooth & tried & (state.evaluation.error > state.first_error)


def _runs_away(
    layout: Layout, options: SolverOptions, point: Iterate, ev: Evaluation
) -> Bool[Array, ""]:
    """Whether multipliers grow without bound while constraints stay violated."""
    large = largest_multiplier(layout, point) > options.runaway_multiplier
    return large & (violation(ev) > options.violated)


def _is_finite(point: Iterate, ev: Evaluation) -> Bool[Array, ""]:
    return jnp.isfinite(ev.error + ev.complementarity + jnp.sum(point.x) + jnp.sum(point.u))


def blank_phase(
    layout: Layout, parameters: Parameters, point: Iterate, accuracy: Accuracy
) -> PhaseState:
    """Return a state of zeros, for loops whose first step begins a phase."""
    weight = jnp.zeros(())
    shapes = jax.eval_shape(
        lambda p, q: evaluate(layout, pairs_of(layout), p, q, weight, accuracy.barrier),
        point,
        parameters,
    )
    nothing = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), shapes)
    zero = jnp.zeros((), int)
    return PhaseState(
        point, nothing, weight, zero, jnp.ones((), bool), weight, weight, undamped(weight)
    )
