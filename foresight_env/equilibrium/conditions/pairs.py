"""Complementarity pairs: every inequality's slack and multiplier, in one array each.

Columns, per stage: lower bounds and upper bounds of the stage vector `w`, the excess of every
constraint row, the rows themselves. Pairs that do not exist (infinite bounds, the excess of rows
that are not elastic, equalities) keep slack 1; all but equalities keep multiplier 0.

An elastic row's multiplier is at most its penalty: the excess is what the row is violated by, and
its own multiplier is what is left of the penalty.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from foresight_env.equilibrium.conditions.layout import Layout


class Parts(NamedTuple):
    """The four kinds of columns of an array over pairs."""

    low: Shaped[Array, "*T w"]
    high: Shaped[Array, "*T w"]
    excess: Shaped[Array, "*T K"]
    row: Shaped[Array, "*T K"]


def split(layout: Layout, values: Shaped[Array, "*T P"]) -> Parts:
    """The columns of each kind."""
    w, rows = layout.n + layout.m, len(layout.rows)
    return Parts(
        values[..., :w],
        values[..., w : 2 * w],
        values[..., 2 * w : 2 * w + rows],
        values[..., 2 * w + rows :],
    )


def join(parts: Parts) -> Shaped[Array, "*T P"]:
    """The inverse of `split`."""
    return jnp.concatenate(parts, axis=-1)


class Pairs(NamedTuple):
    """Which pairs exist, and the bounds that they stand for."""

    exists: Bool[Array, "T P"]
    lower: Float[Array, "T w"]
    """0 where there is no bound, as in `upper`."""
    upper: Float[Array, "T w"]
    elastic: Bool[Array, "K"]
    equality: Bool[Array, "K"]


def pairs_of(layout: Layout) -> Pairs:
    """The (static) pairs of a game."""
    low, high = (jnp.asarray(b) for b in layout.bounds)
    has_low, has_high = jnp.isfinite(low), jnp.isfinite(high)
    elastic, equality = jnp.asarray(layout.elastic, bool), jnp.asarray(layout.equality, bool)
    shape = (layout.game.horizon, len(layout.rows))
    exists = (
        has_low,
        has_high,
        jnp.broadcast_to(elastic, shape),
        jnp.broadcast_to(~equality, shape),
    )
    return Pairs(
        jnp.concatenate(exists, axis=1),
        jnp.where(has_low, low, 0.0),
        jnp.where(has_high, high, 0.0),
        elastic,
        equality,
    )


def distances_to_bounds(
    layout: Layout, pairs: Pairs, w: Float[Array, "T w"]
) -> tuple[Float[Array, "T w"], Float[Array, "T w"]]:
    """`w - lower` and `upper - w`; 0 where there is no bound."""
    exists = split(layout, pairs.exists)
    return (
        jnp.where(exists.low, w - pairs.lower, 0.0),
        jnp.where(exists.high, pairs.upper - w, 0.0),
    )


def count(pairs: Pairs) -> Float[Array, ""]:
    """How many pairs there are, over all stages."""
    return jnp.sum(pairs.exists.astype(float))
