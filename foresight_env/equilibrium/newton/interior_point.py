"""One Newton step for a game's mixed complementarity problem.

Every inequality `g >= 0` gets a slack and a multiplier with `slack * multiplier = barrier`. An
*interior-point* step follows that path down to `SolverOptions.barrier` with Mehrotra's predictor
and corrector (Nocedal and Wright, "Numerical Optimization", 2nd ed., algorithm 14.3). What each
step solves has the size of one stage (modules `newton_system`, `stagewise`).

A *semismooth* step, for starts near a solution, is a plain Newton step on `slack + multiplier -
sqrt(slack^2 + multiplier^2 + 2 barrier) = 0`, which has the same solutions and may start anywhere
(Fischer, Optimization 24, 1992; smoothed as by Kanzow, SIAM J. Matrix Anal. Appl. 17, 1996).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from foresight_env.equilibrium.conditions.kkt import Iterate
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import Pairs, count
from foresight_env.equilibrium.conditions.residual import Evaluation
from foresight_env.equilibrium.conditions.rollout import feedback_rollout
from foresight_env.equilibrium.linear_algebra.stagewise import Factor, factorise
from foresight_env.equilibrium.newton.newton_system import (
    LinearComplementarity,
    direction,
    eliminate_pairs,
    fischer_burmeister,
    on_the_path,
    row_softness,
    stage_system,
)
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.types import Scalar


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


def rolled_out(
    layout: Layout,
    ev: Evaluation,
    factor: Factor,
    ahead: Iterate,
    point: Iterate,
    step: Iterate,
    length: Scalar,
) -> Iterate:
    """Return the next point with states and controls of the closed-loop rollout of the step.

    Where dynamics are linear, or the rollout overflows: those of the straight step.
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
    options: SolverOptions,
    pairs: Pairs,
    point: Iterate,
    ev: Evaluation,
    end: Scalar | float,
    semismooth: Bool[Array, ""] | None,
    weight: Scalar,
    damping: Scalar,
) -> tuple[Iterate, Scalar]:
    """Return the next point, and the part of the step that was taken.

    Args:
        layout: the game's layout.
        options: settings of softness and of the central path.
        pairs: its complementarity pairs.
        point: the present point.
        ev: residual and linearisation there.
        end: complementarity product of the solution.
        semismooth: whether the step is a full semismooth one; None: the program has none.
        weight: convexification weight.
        damping: what is added to controls' curvature and to the softness of rows.
    """

    def on_path() -> LinearComplementarity:
        return on_the_path(pairs, point, jnp.zeros(()))

    def off_path() -> LinearComplementarity:
        return fischer_burmeister(pairs, point, end)

    linear = on_path() if semismooth is None else jax.lax.cond(semismooth, off_path, on_path)
    soft, path = options.softness, options.path
    eliminated = eliminate_pairs(
        layout, pairs, linear, row_softness(soft, ev.error, damping), soft.equality
    )
    system = stage_system(
        layout, point, ev, eliminated, weight, damping, options.convexification.sign_steps
    )
    factor = factorise(system, layout.equal_sizes)
    first = direction(layout, pairs, ev, factor, eliminated, linear)

    def along_the_path() -> tuple[Iterate, Scalar]:
        primal, dual = step_lengths(pairs, point, first, 1.0)
        average = average_product(pairs, point.slack, point.mult)
        predicted = average_product(
            pairs, point.slack + primal * first.slack, point.mult + dual * first.mult
        )
        sigma = jnp.clip(predicted / jnp.maximum(average, 1e-300), 0.0, 1.0) ** 3
        # Complementarity must not run ahead of stationarity.
        wide = jnp.minimum(average, path.width * ev.error)
        barrier = jnp.maximum(jnp.maximum(sigma * average, wide), end)
        second_order = jnp.where(average > path.corrector_end * end, 1.0, 0.0)
        products = barrier - second_order * first.slack * first.mult
        target = on_the_path(pairs, point, products)
        step = direction(layout, pairs, ev, factor, eliminated, target)
        fraction = jnp.maximum(path.fraction, 1.0 - average)
        primal, dual = step_lengths(pairs, point, step, fraction)
        ahead = advance(point, step, primal, dual)
        return rolled_out(layout, ev, factor, ahead, point, step, primal), primal

    if semismooth is None:
        return along_the_path()
    one = jnp.ones(())
    return jax.lax.cond(semismooth, lambda: (advance(point, first, one, one), one), along_the_path)
