"""Backward matrix recursion over stages: a Riccati recursion whose Hessian is not symmetric."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from foresight_env.equilibrium.linear_algebra.small_matrices import (
    SMALL_STAGE,
    eliminate,
    inverse,
    matrix_product,
)
from foresight_env.equilibrium.linear_algebra.transitions import EqualSizes, blocks_of, both_sides


class MatrixRecursion(NamedTuple):
    """Result of the backward matrix recursion, per stage."""

    value: Float[Array, "T n n"]
    gain: Float[Array, "T m n"]
    inverse: Float[Array, "T m m"]
    back: Float[Array, "T n m"]


@lru_cache(maxsize=256)
def matrix_recursion(sizes: EqualSizes | None) -> Any:
    """The recursion as a function of the stages' matrices, to a `MatrixRecursion`.

    Its arguments, in the words of module `stagewise`: `Hxx` (T, n, n); `[0, Hxu]` (T, n, w); what a
    stage's unknowns `(dx_t, du_t)` cost directly, whatever comes later (T, w, w); the transition
    `[A, B]` (T, n, w); rho (T, n).
    """

    @custom_vmap
    def recursion(
        hxx: Array, x_rows: Array, direct: Array, transition: Array, rho: Array
    ) -> MatrixRecursion:
        """One game: where matrices are small, products are fused with the arithmetic around."""
        blocks = None if transition.shape[2] <= SMALL_STAGE else sizes
        return _riccati(hxx, x_rows, direct, transition, rho, blocks)

    @recursion.def_vmap
    def recursion_batched(
        size: int, batched: list[bool], *arguments: Array
    ) -> tuple[MatrixRecursion, MatrixRecursion]:
        """Many games at once."""

        def one(*matrices: Array) -> MatrixRecursion:
            hxx, x_rows, direct, transition, rho = matrices
            return _riccati(hxx, x_rows, direct, transition, rho, None)

        axes = tuple(0 if b else None for b in batched)
        found = jax.vmap(one, in_axes=axes, axis_size=size)(*arguments)
        return found, MatrixRecursion(True, True, True, True)  # type: ignore[arg-type]

    return recursion


def _riccati(
    hxx: Array,
    x_rows: Array,
    direct: Array,
    transition: Array,
    rho: Array,
    sizes: EqualSizes | None,
) -> MatrixRecursion:
    n = hxx.shape[1]
    moves = transition if sizes is None else blocks_of(sizes, transition)

    def step(carry: Array, stage: tuple[Any, ...]) -> tuple[Array, tuple[Array, Array]]:
        h, above, below, z, r = stage
        p = h + carry
        if sizes is None:
            block = matrix_product(z.T, matrix_product(p, z) + above) + below
        else:
            block = both_sides(z, p, above) + below
        return r[:, None] * eliminate(block, n), (p, block)

    begin = jnp.zeros((n, n), hxx.dtype)
    stages = (hxx, x_rows, direct, moves, rho)
    _, (value, block) = jax.lax.scan(step, begin, stages, reverse=True)
    pivot, right = block[:, n:, n:], block[:, n:, :n]
    inverted = inverse(pivot)
    back = matrix_product(block[:, :n, n:], inverted)
    return MatrixRecursion(value, -matrix_product(inverted, right), inverted, back)
