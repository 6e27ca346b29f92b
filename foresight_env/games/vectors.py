"""Arithmetic with vectors of the plane, written out by components.

XLA's CPU back-end (jaxlib 0.10) hands a sum over two entries to a library, whose call takes longer
(0.05 to 0.2 ms) than the whole stage around it.
"""

from __future__ import annotations

import functools
import operator

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.types import AnyArray


def dot(a: Float[AnyArray, "*b k"], b: Float[AnyArray, "*b k"]) -> Float[Array, "*b"]:
    """Sum of products along the last axis, which is short."""
    terms = (jnp.asarray(a[..., k] * b[..., k]) for k in range(a.shape[-1]))
    return functools.reduce(operator.add, terms)


def squared_length(vector: Float[AnyArray, "*b k"]) -> Float[Array, "*b"]:
    """Sum of squares along the last axis, which is short."""
    return dot(vector, vector)
