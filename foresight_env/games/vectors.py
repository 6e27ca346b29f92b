"""Arithmetic with vectors of the plane, written out by components.

XLA's CPU back-end (jaxlib 0.10) hands a sum over two entries to a library, whose call takes longer
(0.05 to 0.2 ms) than the whole stage around it.
"""

from __future__ import annotations

import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games.types import AnyArray


def components(vector: Float[AnyArray, "*b k"]) -> list[Float[AnyArray, "*b"]]:
    """Entries along the last axis, which is short.

    By one operation, whose derivatives are one each too: costs are differentiated twice, so that
    what a cost does is most of what a solver's program holds.
    """
    if isinstance(vector, np.ndarray):
        return [np.asarray(part) for part in np.moveaxis(vector, -1, 0)]
    axis = vector.ndim - 1
    parts = jax.lax.split(vector, (1,) * vector.shape[axis], axis)
    return [jax.lax.squeeze(part, (axis,)) for part in parts]


def dot(a: Float[AnyArray, "*b k"], b: Float[AnyArray, "*b k"]) -> Float[Array, "*b"]:
    """Sum of products along the last axis, which is short."""
    terms = (jnp.asarray(x * y) for x, y in zip(components(a), components(b), strict=True))
    return functools.reduce(operator.add, terms)


def squared_length(vector: Float[AnyArray, "*b k"]) -> Float[Array, "*b"]:
    """Sum of squares along the last axis, which is short."""
    return functools.reduce(operator.add, map(jnp.square, components(vector)))
