"""Curvature of nonlinear dynamics: second derivatives of `q' f(x, u)`.

Far from a solution only its positive part is used (module `newton.convexification`); without any of
it, Newton steps ignore how steering acts on the heading.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.identical_players import (
    apart,
    block_diagonal,
    inputs_of,
    moving_alike,
    spread,
)
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.linear_algebra.small_matrices import matrix_product
from foresight_env.equilibrium.settings import Convexification
from foresight_env.games.types import Scalar


def dynamics_hessian(
    layout: Layout,
    previous: Float[Array, "T n"],
    u: Float[Array, "T m"],
    q: Float[Array, "T n"],
    convexity: Scalar | None = None,
    sign_steps: int = Convexification.sign_steps,
) -> Float[Array, "T w w"] | None:
    """Second derivatives of `q_t' f(t, x_t, u_t)` by `(x_t, u_t)`; None for linear dynamics.

    `convexity`: the convexification weight, the part of each player's negative curvature that is
    left out, in [0, 1] (None: nothing); `sign_steps`: as `Convexification` has them.
    """
    if layout.linear:
        return None
    game = layout.game
    stages = jnp.arange(1, game.horizon + 1)
    runs = moving_alike(game)
    blocks: list[Array] = []  # (T, G, k, k) of every run
    for members in runs:
        dynamics = game.players[members.start].dynamics
        size = dynamics.state_size

        def lagrangian(v, costate, t, dynamics=dynamics, size=size):
            return jnp.dot(costate, dynamics(t, v[:size], v[size:]))

        own = inputs_of(layout, previous, u, members)
        if dynamics.linear:
            blocks.append(jnp.zeros((*own.shape, own.shape[-1]), u.dtype))
            continue
        side_by_side = jax.vmap(jax.hessian(lagrangian), in_axes=(0, 0, None))
        blocks.append(jax.vmap(side_by_side)(own, apart(q, layout.state_slices, members), stages))
    if convexity is not None:

        def partly_convex(exact: list[Array]) -> list[Array]:
            return jax.tree.map(
                lambda b, positive: b + convexity * (positive - b),
                exact,
                _positive_parts(exact, sign_steps),
            )

        blocks = jax.lax.cond(convexity > 0.0, partly_convex, lambda b: b, blocks)
    sizes = [game.state_sizes[members.start] for members in runs]
    kinds = [(slice(0, size), slice(size, None)) for size in sizes]

    def quadrant(row: int, column: int) -> Array:
        cuts = zip(blocks, kinds, strict=True)
        return block_diagonal([spread(block[..., k[row], k[column]]) for block, k in cuts])

    rows = [jnp.concatenate([quadrant(r, c) for c in (0, 1)], axis=2) for r in (0, 1)]
    return jnp.concatenate(rows, axis=1)


def _positive_parts(blocks: list[Array], sign_steps: int) -> list[Array]:
    """Of all runs' blocks at once where these are of one size."""
    if len({block.shape[-1] for block in blocks}) > 1:
        return [positive_part(block, sign_steps) for block in blocks]
    ends = np.cumsum([block.shape[1] for block in blocks])
    return jnp.split(positive_part(jnp.concatenate(blocks, axis=1), sign_steps), ends[:-1], axis=1)


def positive_part(
    matrix: Float[Array, "*b k k"], sign_steps: int = Convexification.sign_steps
) -> Float[Array, "*b k k"]:
    """`(M + |M|) / 2` of symmetric matrices, `|M| = M sign(M)`.

    The sign is found by Newton and Schulz's iteration (Higham, "Functions of Matrices", section
    5.3), which needs products only; LAPACK's batched calls from two threads at once make jaxlib
    (0.10) hang.
    """
    size = jnp.sqrt(jnp.sum(matrix**2, axis=(-2, -1), keepdims=True))
    begin = matrix / jnp.where(size > 0.0, size, 1.0)

    def step(_: Any, sign: Array) -> Array:
        return 1.5 * sign - 0.5 * matrix_product(sign, matrix_product(sign, sign))

    sign = jax.lax.fori_loop(0, sign_steps, step, begin)
    magnitude = matrix_product(matrix, sign)
    return 0.5 * matrix + 0.25 * (magnitude + jnp.swapaxes(magnitude, -2, -1))
