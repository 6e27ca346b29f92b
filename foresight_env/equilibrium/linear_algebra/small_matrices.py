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
"""Stage size up to which products are fused: a library call costs more than its arithmetic there.
`benchmarks.growth` measures the time of a step by size."""
PIVOTS = 8
"""Variables eliminated at a time: each pass over a stage's matrix costs a fixed time, and inverses
of more than 8 rows cost more than a pass. `benchmarks.merge` measures games of 2 to 8 cars."""


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

    Gauss elimination without row exchanges, from the last variables on, `PIVOTS` at a time: they
    are controls, which carry the players' own curvature. What rounding is left, Newton's iteration
    corrects.
    """
    for end in range(block.shape[-1], first, -PIVOTS):
        kept = max(first, end - PIVOTS)
        rows = matrix_product(inverse(block[..., kept:end, kept:end]), block[..., kept:end, :kept])
        block = block[..., :kept, :kept] - matrix_product(block[..., :kept, kept:end], rows)
    return block


def inverse(matrix: Float[Array, "*b m m"]) -> Float[Array, "*b m m"]:
    """Inverse by halves (Schur complements), without row exchanges.

    A fraction of the time that LAPACK takes for matrices of these sizes, and without its batched
    calls, which make jaxlib (0.10) wait for ever where two threads make them at once.
    """
    size = matrix.shape[-1]
    if size <= 2:
        return _small_inverse(matrix)
    half = 2
    while 2 * half < size:
        half *= 2
    a, b = matrix[..., :half, :half], matrix[..., :half, half:]
    c, d = matrix[..., half:, :half], matrix[..., half:, half:]
    inverse_a = inverse(a)
    left, right = matrix_product(c, inverse_a), matrix_product(inverse_a, b)
    inverse_d = inverse(d - matrix_product(left, b))
    upper = matrix_product(right, inverse_d)
    top = jnp.concatenate([inverse_a + matrix_product(upper, left), -upper], axis=-1)
    bottom = jnp.concatenate([-matrix_product(inverse_d, left), inverse_d], axis=-1)
    return jnp.concatenate([top, bottom], axis=-2)


def _small_inverse(matrix: Float[Array, "*b k k"]) -> Float[Array, "*b k k"]:
    """Inverse of a 1 x 1 or 2 x 2 matrix by its closed form."""
    if matrix.shape[-1] == 1:
        return 1.0 / matrix
    a, b, c, d = (matrix[..., i, j] for i in (0, 1) for j in (0, 1))
    adjugate = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b * c)[..., None, None]
