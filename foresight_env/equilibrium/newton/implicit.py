"""The equilibrium as a differentiable function of `initial_state`, `theta` and `gamma`.

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

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.linearisation import first_order
from foresight_env.equilibrium.conditions.pairs import Parts, join, pairs_of, split
from foresight_env.equilibrium.conditions.residual import (
    Evaluation,
    costates,
    stationarity,
    violation,
)
from foresight_env.equilibrium.linear_algebra.stagewise import factorise, solve_stages
from foresight_env.equilibrium.newton.newton_system import (
    eliminate_pairs,
    on_the_path,
    stage_system,
)
from foresight_env.equilibrium.newton.phase import (
    Accuracy,
    PhaseState,
    accuracy_of,
    blank_phase,
    init_or_step_phase,
    phase_ended,
    succeeded,
)
from foresight_env.equilibrium.newton.schedule import phase_count, phase_rules
from foresight_env.equilibrium.newton.start import Start, begin_phase
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.types import Scalar


class Equilibrium(NamedTuple):
    """Raw result of one solve on joint vectors."""

    point: Iterate
    costates: Float[Array, "T n"]
    error: Scalar
    complementarity: Scalar
    violation: Scalar
    iterations: Int[Array, ""]
    success: Bool[Array, ""]
    began: Bool[Array, ""] | None = None
    """Whether the first interior-point phase began; else something was not finite at its start."""
    evaluation: Evaluation | None = None
    """At the point, with all curvature: for derivatives. None where none are taken."""


def result_of(state: PhaseState, iterations: Int[Array, ""], accuracy: Accuracy) -> Equilibrium:
    """Return the result of a phase; `iterations`: of all phases together."""
    ev = state.evaluation
    return Equilibrium(
        state.point,
        ev.q,
        state.error,
        ev.complementarity,
        violation(ev),
        iterations,
        succeeded(state, accuracy),
    )


@partial(jax.jit, static_argnums=(0, 1), inline=True)
def _solve(
    layout: Layout, options: SolverOptions, parameters: Parameters, start: Start
) -> Equilibrium:
    """Run phases until one succeeds; module `start` has where each begins."""
    accuracy = accuracy_of(options, start.barrier)
    first = jnp.ones((), int) if start.warm is None else jnp.where(start.warm, 0, 1)
    last = phase_count(options, start.warm, start.limits)

    def step(solving: _Solving) -> _Solving:
        number = solving.number
        rules = phase_rules(layout, options, number, start.warm, start.limits)
        phase = init_or_step_phase(
            layout,
            options,
            parameters,
            solving.phase,
            solving.begins,
            solving.repeats,
            lambda: begin_phase(layout, options, parameters, start, number),
            rules,
            accuracy,
        )
        ended = phase_ended(layout, options, phase, rules, accuracy)
        success = succeeded(phase, accuracy)
        reached = phase.evaluation.error
        moved = (reached < phase.first_error) | (reached > phase.first_error)
        moved = moved | jnp.isfinite(phase.error)
        again = ended & ~success & (number < last)
        # Derivatives of the solution need all curvature.
        repeats = success & (phase.used != 0.0)
        return _Solving(
            number + again,
            phase,
            solving.spent + jnp.where(ended & ~repeats, phase.iteration, 0),
            solving.began | (ended & (success | ((number == 1) & moved))),
            again,
            repeats,
            ended & ~again & ~repeats,
        )

    zero, no = jnp.zeros((), int), jnp.zeros((), bool)
    blank = blank_phase(layout, parameters, start.point, accuracy)
    end = jax.lax.while_loop(
        lambda solving: ~solving.done, step, _Solving(first, blank, zero, no, ~no, no, no)
    )
    result = result_of(end.phase, end.spent, accuracy)
    return result._replace(began=end.began, evaluation=end.phase.evaluation)


class _Solving(NamedTuple):
    number: Int[Array, ""]
    """Of the phase."""
    phase: PhaseState
    spent: Int[Array, ""]
    """Newton steps of the phases that have ended."""
    began: Bool[Array, ""]
    begins: Bool[Array, ""]
    """Whether the next step begins a phase."""
    repeats: Bool[Array, ""]
    """Whether it evaluates the solution once more."""
    done: Bool[Array, ""]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def equilibrium(
    layout: Layout, options: SolverOptions, parameters: Parameters, start: Start
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
    options: SolverOptions,
    result: Equilibrium,
    parameters: Parameters,
    change: Parameters,
) -> Iterate:
    """Directional derivative of states, controls and multipliers."""
    pairs = pairs_of(layout)
    assert result.evaluation is not None
    point, ev = jax.tree.map(jax.lax.stop_gradient, (result.point, result.evaluation))
    fixed = jax.tree.map(jax.lax.stop_gradient, parameters)
    # On the path `slack * multiplier` stays what it is.
    added = options.softness.tangent
    eliminated = eliminate_pairs(
        layout,
        pairs,
        on_the_path(pairs, point, jnp.zeros(())),
        added,
        options.softness.equality,
    )
    factor = factorise(stage_system(layout, point, ev, eliminated), layout.equal_sizes)
    n = layout.n

    # `initial_state` acts on the conditions through the first stage's dynamics alone.
    def conditions(p: Parameters) -> tuple[Array, Array, Array]:
        at = first_order(layout, point, p)
        lin = ev.lin._replace(gradient=at.gradient, rho=at.rho)
        return stationarity(lin, costates(lin, n)), at.values, at.penalty

    _, (r_u, rows, penalty) = jax.jvp(conditions, (fixed,), (change,))
    known, soft, jacobian = eliminated.ratios, eliminated.softness, ev.lin.jacobian
    wanted = -rows + known.excess * penalty

    moved = jnp.asarray(change.initial_state)

    def solved(rhs: Array) -> tuple[Array, Array]:
        """Changes of the stage vector and of the row multipliers."""
        pull = jnp.einsum("tka,tk->ta", ev.lin.share * jacobian, rhs / soft)
        dx, du = solve_stages(
            factor, -pull[:, :n], r_u - pull[:, n:], jnp.zeros_like(point.x), moved
        )
        dw = jnp.concatenate([dx, du], axis=1)
        return dw, (rhs - jnp.einsum("tka,ta->tk", jacobian, dw)) / soft

    dw, mult = solved(wanted)
    if layout.rows:
        dw, mult = jax.lax.fori_loop(
            0,
            options.softness.tangent_corrections,
            lambda _, last: solved(wanted + added * last[1]),
            (dw, mult),
        )
    slope = jnp.einsum("tka,ta->tk", jacobian, dw)
    excess = known.excess * (mult - penalty)
    exists = split(layout, pairs.exists)
    low, high = jnp.where(exists.low, dw, 0.0), jnp.where(exists.high, -dw, 0.0)
    slack = Parts(low, high, excess, jnp.where(pairs.equality, 0.0, slope + excess + rows))
    mults = Parts(
        -known.low * low,
        -known.high * high,
        jnp.where(pairs.elastic, penalty - mult, 0.0),
        mult,
    )
    ok = jnp.where(result.success, 1.0, jnp.nan)
    return jax.tree.map(lambda v: ok * v, Iterate(dw[:, :n], dw[:, n:], join(slack), join(mults)))
