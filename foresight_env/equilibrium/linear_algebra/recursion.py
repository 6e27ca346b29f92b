"""Affine recursions over stages, written so that XLA compiles them to one tight loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def affine_recursion(
    matrices: Float[Array, "T n n"],
    offsets: Float[Array, "T n"],
    start: Float[Array, "n"],
    reverse: bool = False,
) -> Float[Array, "T n"]:
    """`y_t = M_t y_{t-1} + c_t` from `y_0 = start` (or downward from the last stage).

    A product written as a sum is fused with the rest of the step: at these sizes that takes a
    third of the time of a library call per stage.
    """

    def step(y: Array, stage: tuple[Array, Array]) -> tuple[Array, Array]:
        matrix, offset = stage
        y = jnp.sum(matrix * y[None, :], axis=1) + offset
        return y, y

    return jax.lax.scan(step, start, (matrices, offsets), reverse=reverse)[1]
