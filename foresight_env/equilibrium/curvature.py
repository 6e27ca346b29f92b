"""Curvature of nonlinear dynamics: second derivatives of `q' f(x, u)`.

Far from a solution only its positive part is used (module `convexity`); without any of it, nothing
tells the method how steering acts on the heading.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.layout import Layout
from foresight_env.equilibrium.small_matrices import matrix_product
from foresight_env.games.types import Scalar

SIGN_STEPS = 10
"""Newton-Schulz steps: eigenvalues above a twentieth of the matrix norm are told apart by sign."""


def dynamics_hessian(
    layout: Layout,
    previous: Float[Array, "T n"],
    u: Float[Array, "T m"],
    q: Float[Array, "T n"],
    convexity: Scalar | None = None,
) -> Float[Array, "T w w"] | None:
    """Second derivatives of `q_t' f(t, x_t, u_t)` by `(x_t, u_t)`; None for linear dynamics.

    `convexity`: how much of each player's negative part is left out, in [0, 1] (None: nothing).
    """
    if layout.linear:
        return None
    n, horizon = layout.n, layout.game.horizon
    stages = jnp.arange(1, horizon + 1)
    blocks: dict[int, Array] = {}
    for i, player in enumerate(layout.game.players):
        if player.dynamics.linear:
            continue
        of_x, of_u = layout.state_slices[i], layout.control_slices[i]
        size = player.dynamics.state_size

        def lagrangian(v, t, costate, dynamics=player.dynamics, size=size):
            return jnp.dot(costate, dynamics(t, v[:size], v[size:]))

        own = jnp.concatenate([previous[:, of_x], u[:, of_u]], axis=1)
        blocks[i] = jax.vmap(jax.hessian(lagrangian))(own, stages, q[:, of_x])
    if convexity is not None:

        def partly_convex(exact: dict[int, Array]) -> dict[int, Array]:
            return jax.tree.map(
                lambda b, positive: b + convexity * (positive - b), exact, _positive_parts(exact)
            )

        blocks = jax.lax.cond(convexity > 0.0, partly_convex, lambda b: b, blocks)
    total = jnp.zeros((horizon, n + layout.m, n + layout.m), u.dtype)
    for i, block in blocks.items():
        of_x, of_u = layout.state_slices[i], layout.control_slices[i]
        place = np.r_[of_x.start : of_x.stop, n + of_u.start : n + of_u.stop]
        total = total.at[:, place[:, None], place[None, :]].set(block)
    return total


def _positive_parts(blocks: dict[int, Array]) -> dict[int, Array]:
    """Of each player's blocks (T, k, k); of all players at once where these are of one size."""
    sizes = {block.shape[-1] for block in blocks.values()}
    if len(sizes) > 1:
        return {i: positive_part(block) for i, block in blocks.items()}
    positive = positive_part(jnp.stack(list(blocks.values())))
    return dict(zip(blocks, positive, strict=True))


def positive_part(matrix: Float[Array, "*b k k"]) -> Float[Array, "*b k k"]:
    """`(M + |M|) / 2` of symmetric matrices, `|M| = M sign(M)`.

    The sign is found by Newton and Schulz's iteration (Higham, "Functions of Matrices", section
    5.3), which needs products only; LAPACK's batched calls from two threads at once make jaxlib
    (0.10) wait for ever.
    """
    size = jnp.sqrt(jnp.sum(matrix**2, axis=(-2, -1), keepdims=True))
    begin = matrix / jnp.where(size > 0.0, size, 1.0)

    def step(_: Any, sign: Array) -> Array:
        return 1.5 * sign - 0.5 * matrix_product(sign, matrix_product(sign, sign))

    sign = jax.lax.fori_loop(0, SIGN_STEPS, step, begin)
    magnitude = matrix_product(matrix, sign)
    return 0.5 * matrix + 0.25 * (magnitude + jnp.swapaxes(magnitude, -2, -1))
