"""The linear system of one Newton step: pairs eliminated, stages assembled, steps recovered."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.curvature import dynamics_hessian
from foresight_env.equilibrium.conditions.kkt import Iterate
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import Pairs, Parts, join, split
from foresight_env.equilibrium.conditions.residual import Evaluation
from foresight_env.equilibrium.linear_algebra.stagewise import Factor, StageSystem, solve_stages
from foresight_env.equilibrium.settings import Convexification, Softness
from foresight_env.games.types import Scalar


class LinearComplementarity(NamedTuple):
    """Complementarity, linear in the step: `slope d_slack + own d_mult = target`, per pair."""

    slope: Float[Array, "T P"]
    own: Float[Array, "T P"]
    target: Float[Array, "T P"]


def on_the_path(pairs: Pairs, point: Iterate, wanted: Array) -> LinearComplementarity:
    """`slack * multiplier` becomes `wanted`, to first order."""
    target = jnp.where(pairs.exists, wanted - point.slack * point.mult, 0.0)
    return LinearComplementarity(point.mult, point.slack, target)


def fischer_burmeister(
    pairs: Pairs, point: Iterate, barrier: Scalar | float
) -> LinearComplementarity:
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
    return LinearComplementarity(
        jnp.where(pairs.exists, rest(s, m), 0.0),
        jnp.where(pairs.exists, rest(m, s), 1.0),
        jnp.where(pairs.exists, gap, 0.0),
    )


class Eliminated(NamedTuple):
    """Coefficients of `LinearComplementarity` with slacks and multipliers eliminated."""

    ratios: Parts
    """Slopes over own coefficients of bounds; of rows and excess, own coefficients over slopes."""
    softness: Float[Array, "T K"]
    """`-d g / d mult` of each row."""


def row_softness(softness: Softness, error: Scalar, damping: Scalar) -> Scalar:
    """Return what a Newton step from a point with this residual adds to the softness of rows."""
    return damping + jnp.where(error < softness.final_residual, softness.final, softness.least)


def eliminate_pairs(
    layout: Layout,
    pairs: Pairs,
    linear: LinearComplementarity,
    softness: Scalar | float,
    equality: float = Softness.equality,
) -> Eliminated:
    """Coefficients that the stage matrices and every right-hand side share.

    `softness` is added to that of all rows: a proximal term of their multipliers; `equality` is
    that of equality rows, see `Softness`.
    """
    slope, own = split(layout, linear.slope), split(layout, linear.own)
    excess = jnp.where(pairs.elastic, own.excess / jnp.where(pairs.elastic, slope.excess, 1.0), 0.0)
    row = own.row / jnp.where(pairs.equality, 1.0, slope.row)
    total = softness + jnp.where(pairs.equality, equality, row + excess)
    return Eliminated(Parts(slope.low / own.low, slope.high / own.high, excess, row), total)


def stage_system(
    layout: Layout,
    point: Iterate,
    ev: Evaluation,
    eliminated: Eliminated,
    convexity: Scalar | None = None,
    damping: Scalar | float = 0.0,
    sign_steps: int = Convexification.sign_steps,
) -> StageSystem:
    """The linear system with slacks and all multipliers eliminated.

    `convexity`: the convexification weight of the dynamics' curvature (None: nothing is left out);
    `damping`: what is added to the controls' own curvature; `sign_steps`: as `Convexification` has
    them.
    """
    lin = ev.lin
    of_controls = jnp.arange(layout.n + layout.m) >= layout.n
    diagonal = eliminated.ratios.low + eliminated.ratios.high + damping * of_controls
    eye = jnp.eye(diagonal.shape[1], dtype=bool)
    hessian = lin.hessian + jnp.where(eye, diagonal[:, :, None], 0.0)
    if layout.rows:
        weighted = lin.jacobian / eliminated.softness[:, :, None]
        hessian = hessian + jnp.einsum("tka,tkb->tab", lin.share * lin.jacobian, weighted)
    curvature = dynamics_hessian(layout, lin.previous, point.u, ev.q, convexity, sign_steps)
    return StageSystem(hessian, curvature, lin.a, lin.b, lin.rho)


def direction(
    layout: Layout,
    pairs: Pairs,
    ev: Evaluation,
    factor: Factor,
    eliminated: Eliminated,
    linear: LinearComplementarity,
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
    pull = jnp.einsum("tka,tk->ta", lin.share * lin.jacobian, wanted / eliminated.softness)
    dx, du = solve_stages(
        factor, shift[:, :n] - pull[:, :n], stationary - pull[:, n:], res.defect, jnp.zeros(n)
    )
    dw = jnp.concatenate([dx, du], axis=1)
    reached = jnp.sum(lin.jacobian * dw[:, None, :], axis=2)
    mult = (wanted - reached) / eliminated.softness
    exists = split(layout, pairs.exists)
    excess = excess + known.excess * mult
    reached = reached + excess + res.rows
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
