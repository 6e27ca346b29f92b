"""Products with the joint dynamics' matrices, which are block-diagonal by player.

`A` and `B` are block-diagonal. Where all players have states and controls of the same sizes, their
blocks fit into one array, and a product costs an N-th of the dense one.
"""

from __future__ import annotations

import functools
import operator
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class EqualSizes(NamedTuple):
    """Of a game whose players all have states of one size and controls of one size."""

    players: int
    state: int
    control: int


class Blocks(NamedTuple):
    """The players' own blocks, of all stages or of one."""

    a: Float[Array, "*T N k k"]
    b: Float[Array, "*T N k c"]


def blocks_of(sizes: EqualSizes, transition: Float[Array, "T n w"]) -> Blocks:
    """The blocks of `[A, B]`."""
    count, k, c = sizes
    first = count * k
    a = [transition[:, i * k : (i + 1) * k, i * k : (i + 1) * k] for i in range(count)]
    b = [
        transition[:, i * k : (i + 1) * k, first + i * c : first + (i + 1) * c]
        for i in range(count)
    ]
    return Blocks(jnp.stack(a, axis=1), jnp.stack(b, axis=1))


def both_sides(
    blocks: Blocks, matrix: Float[Array, "n n"], above: Float[Array, "n w"]
) -> Float[Array, "w w"]:
    """`Z' (M Z + above)` with `Z = [A, B]` of one stage."""
    moved = jnp.concatenate([_right(matrix, blocks.a), _right(matrix, blocks.b)], axis=1) + above
    return jnp.concatenate([_left(blocks.a, moved), _left(blocks.b, moved)])


def _right(matrix: Float[Array, "r n"], blocks: Float[Array, "N k c"]) -> Float[Array, "r Nc"]:
    """`M Z`, a sum written out: at these sizes XLA makes one loop of it."""
    count, size, _ = blocks.shape
    parts = matrix.reshape(-1, count, size)
    terms = (parts[:, :, k, None] * blocks[None, :, k, :] for k in range(size))
    return functools.reduce(operator.add, terms).reshape(len(matrix), -1)


def _left(blocks: Float[Array, "N k c"], matrix: Float[Array, "n w"]) -> Float[Array, "Nc w"]:
    """`Z' M`."""
    count, size, _ = blocks.shape
    parts = matrix.reshape(count, size, -1)
    terms = (blocks[:, k, :, None] * parts[:, k, None, :] for k in range(size))
    return functools.reduce(operator.add, terms).reshape(-1, matrix.shape[1])
