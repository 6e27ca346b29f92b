"""Residuals of the perturbed KKT conditions at a point, with the derivatives that they need."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.linearisation import Linearisation, linearise
from foresight_env.equilibrium.conditions.pairs import Pairs, distances_to_bounds, split
from foresight_env.equilibrium.linear_algebra.recursion import affine_recursion
from foresight_env.games.types import Scalar


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


# Jitted, so that a program that evaluates at several places is traced once. Inlined, since XLA
# folds constants into calls, and fails (jaxlib 0.10) where that leads it to a call of LAPACK.
@partial(jax.jit, static_argnums=0, inline=True)
def evaluate(
    layout: Layout,
    pairs: Pairs,
    point: Iterate,
    parameters: Parameters,
    convexity: Scalar,
    barrier: Scalar | float,
) -> Evaluation:
    """Derivatives and residuals at `point`, with products of `barrier` in mind.

    `convexity`: the convexification weight, see `linearise`.
    """
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
    # Semismooth steps pass through negative slacks and multipliers, which are no solution.
    products = jnp.maximum(point.slack, 0.0) * jnp.maximum(point.mult, 0.0)
    off_path = jnp.where(pairs.exists, barrier - products, 0.0)
    return Evaluation(
        lin, q, residual, _largest(jnp.concatenate(residual, axis=1)), _largest(off_path)
    )


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


def costates(lin: Linearisation, n: int) -> Float[Array, "T n"]:
    """Each player's current-value costate of that player's state, by the backward recursion."""

    # q_t = g_t + (rho A)_{t+1}' q_{t+1}, and nothing comes after the last stage.
    pulled = lin.rho[:, :, None] * jnp.swapaxes(lin.a, 1, 2)
    pulled = jnp.concatenate([pulled[1:], jnp.zeros_like(pulled[:1])])
    zero = jnp.zeros(n, lin.gradient.dtype)
    return affine_recursion(pulled, lin.gradient[:, :n], zero, reverse=True)


def stationarity(lin: Linearisation, q: Float[Array, "T n"]) -> Float[Array, "T m"]:
    """`d_u L + B' q`: zero where no player can improve to first order."""
    n = q.shape[1]
    return lin.gradient[:, n:] + jnp.einsum("tnm,tn->tm", lin.b, q)
