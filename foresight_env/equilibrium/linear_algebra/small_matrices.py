"""Products, inverses and eliminations of a stage's matrices, which are too small for libraries.

Written so that XLA fuses them with what surrounds them.
"""

from __future__ import annotations

import functools
import operator

import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

SMALL_STAGE = 16
"""Up to this stage size a library call costs more than the arithmetic it does."""
PIVOTS = 2
"""Variables eliminated at a time: half the passes over a stage's matrix of one at a time."""


@custom_vmap
def matrix_product(a: Array, b: Array) -> Array:
    """`a @ b` of small matrices, fused with what surrounds it instead of a library call each."""
    inner = a.shape[-1]
    if max(inner, b.shape[-1]) > SMALL_STAGE:
        return a @ b
    if a.ndim == 2:
        return _fused_product(a, b)
    # For a stack of stages, a sum written out is three times as fast as a reduction.
    terms = (a[..., :, k : k + 1] * b[..., k : k + 1, :] for k in range(inner))
    return functools.reduce(operator.add, terms)


def _fused_product(a: Array, b: Array) -> Array:
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


@matrix_product.def_vmap
def _matrix_product_batched(
    size: int, batched: list[bool], a: Array, b: Array
) -> tuple[Array, bool]:
    """For many games at once a batched library product beats the fused loop."""
    a, b = (v if is_batched else v[None] for v, is_batched in zip((a, b), batched, strict=True))
    return a @ b, True


def eliminate(block: Float[Array, "*b w w"], first: int) -> Float[Array, "*b n n"]:
    """`A - B D^-1 C` of the block `[[A, B], [C, D]]`, A having `first` rows.

    Gauss elimination without row exchanges, two variables at a time. The order (controls, then row
    multipliers) keeps pivots away from 0: controls carry the players' own curvature, and
    multipliers a softness that is never negative (Vanderbei, SIAM J. Optim. 5, 1995). What rounding
    is left, Newton's iteration corrects.
    """
    size = block.shape[-1]
    for k in range(first, size, PIVOTS):
        now = slice(k, min(k + PIVOTS, size))
        rows = _fused_product(_small_inverse(block[..., now, now]), block[..., now, :])
        block = block - _fused_product(block[..., :, now], rows)
    return block[..., :first, :first]


def inverse(matrix: Float[Array, "*b m m"]) -> Float[Array, "*b m m"]:
    """Inverse by Gauss-Jordan elimination in the same order as `eliminate`."""
    size = matrix.shape[-1]
    eye = jnp.broadcast_to(jnp.eye(size, dtype=matrix.dtype), matrix.shape)
    both = jnp.concatenate([matrix, eye], axis=-1)
    for k in range(0, size, PIVOTS):
        now = slice(k, min(k + PIVOTS, size))
        rows = _fused_product(_small_inverse(both[..., now, now]), both[..., now, :])
        others = both - _fused_product(both[..., :, now], rows)
        both = jnp.concatenate(
            [others[..., : now.start, :], rows, others[..., now.stop :, :]], axis=-2
        )
    return both[..., size:]


def _small_inverse(matrix: Float[Array, "*b k k"]) -> Float[Array, "*b k k"]:
    """Inverse of a 1 x 1 or 2 x 2 matrix by its closed form."""
    if matrix.shape[-1] == 1:
        return 1.0 / matrix
    a, b, c, d = (matrix[..., i, j] for i in (0, 1) for j in (0, 1))
    adjugate = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b * c)[..., None, None]
