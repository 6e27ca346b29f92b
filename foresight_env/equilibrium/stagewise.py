"""Newton's linear system by a recursion over stages: linear in the horizon (a coupled Riccati).

Solves, for all stages t and given right-hand sides,

    dq_t = Hxx dx_{t+1} + Hxu du_t + r_x + rho_{t+1} d(A_{t+1}' q_{t+1}),
    0    = Hux dx_{t+1} + Huu du_t + B_t' dq_t + d(B_t)' q_t + r_u,
    dx_{t+1} = A_t dx_t + B_t du_t + d_t,

whose solution has the form `du_t = K_t dx_t + k_t`, `dq_t = P_t dx_{t+1} + Hxu du_t + p_t`. H is
not symmetric: its rows belong to different players.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from foresight_env.equilibrium.recursion import affine_recursion


class StageSystem(NamedTuple):
    """Matrices of the linear system, per stage."""

    hessian: Float[Array, "T w w"]
    dynamics_hessian: Float[Array, "T w w"]
    """Second derivatives of `q_t' f` by (x_t, u_t)."""
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    rho: Float[Array, "T n"]


class Factor(NamedTuple):
    """What vector solves reuse."""

    gain: Float[Array, "T m n"]
    """K."""
    inverse: Float[Array, "T m m"]
    """Inverse of what multiplies `du_t`."""
    left: Float[Array, "T m n"]
    """`Hux + B' P`."""
    value: Float[Array, "T n n"]
    """P."""
    closed: Float[Array, "T n n"]
    """`A + B K`: how `dx` moves."""
    adjoint: Float[Array, "T n n"]
    """How the offsets p move backward."""
    back: Float[Array, "T n m"]
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    rho: Float[Array, "T n"]


class _Recursion(NamedTuple):
    """What the backward matrix recursion leaves behind, per stage."""

    value: Float[Array, "T n n"]
    gain: Float[Array, "T m n"]
    inverse: Float[Array, "T m m"]
    back: Float[Array, "T n m"]


SMALL_STAGE = 16
"""Up to this stage size a library call costs more than the arithmetic it does."""


def factorise(system: StageSystem) -> Factor:
    """Backward matrix recursion."""
    n = system.a.shape[1]
    transition = jnp.concatenate([system.a, system.b], axis=2)
    left_now = system.hessian[:, n:, :n]
    control_now = jnp.zeros_like(system.hessian).at[:, n:, n:].set(system.hessian[:, n:, n:])
    # What the present stage adds: x_{t+1} = transition (x_t, u_t) enters Hux and Hxu.
    direct = system.dynamics_hessian + control_now
    direct = direct.at[:, n:, :].add(left_now @ transition)
    direct = direct.at[:, :, n:].add(jnp.swapaxes(transition, 1, 2) @ system.hessian[:, :n, n:])
    value, gain, inverse, back = _recursion(
        system.hessian[:, :n, :n], direct, transition, system.rho
    )
    backed = back @ inverse
    transposed = jnp.swapaxes(system.b, 1, 2)
    return Factor(
        gain,
        inverse,
        left_now + transposed @ value,
        value,
        system.a + system.b @ gain,
        system.rho[:, :, None] * (jnp.swapaxes(system.a, 1, 2) - backed @ transposed),
        back,
        system.a,
        system.b,
        system.rho,
    )


def solve_stages(
    factor: Factor,
    r_x: Float[Array, "T n"],
    r_u: Float[Array, "T m"],
    defect: Float[Array, "T n"],
    dx0: Float[Array, "n"],
) -> tuple[Float[Array, "T n"], Float[Array, "T m"]]:
    """`dx_{t+1}`, `du_t` for one right-hand side; `vmap` over several."""
    transposed = jnp.swapaxes(factor.b, 1, 2)
    fixed = _times(factor.left, defect) + _times(transposed, r_x) + r_u
    pushed = _times(jnp.swapaxes(factor.a, 1, 2), _times(factor.value, defect) + r_x)
    offset = factor.rho * (pushed - _times(factor.back, _times(factor.inverse, fixed)))
    # y_t: what stages after t add to p_t; none after the last one.
    later = affine_recursion(factor.adjoint, offset, jnp.zeros_like(dx0), reverse=True)
    y = jnp.concatenate([later[1:], jnp.zeros_like(later[:1])])
    k = -_times(factor.inverse, fixed + _times(transposed, y))
    dx = affine_recursion(factor.closed, _times(factor.b, k) + defect, dx0)
    before = jnp.concatenate([dx0[None], dx[:-1]])
    return dx, _times(factor.gain, before) + k


def _times(matrices: Float[Array, "T a b"], vectors: Float[Array, "T b"]) -> Float[Array, "T a"]:
    return jnp.sum(matrices * vectors[:, None, :], axis=2)


def _riccati(
    hxx: Array,
    direct: Array,
    transition: Array,
    rho: Array,
    product: Callable[[Array, Array], Array],
    own_elimination: bool,
) -> _Recursion:
    n = hxx.shape[1]

    def step(carry: Array, stage: tuple[Array, ...]) -> tuple[Array, tuple[Array, ...]]:
        h, d, z, r = stage
        p = h + carry
        block = product(product(z.T, p), z) + d
        pivot, right = block[n:, n:], block[n:, :n]
        gain = -_eliminate(pivot, right) if own_elimination else -jnp.linalg.inv(pivot) @ right
        carry = r[:, None] * (block[:n, :n] + product(block[:n, n:], gain))
        return carry, (p, gain, pivot, block[:n, n:])

    begin = jnp.zeros((n, n), hxx.dtype)
    stages = (hxx, direct, transition, rho)
    _, (value, gain, pivot, back) = jax.lax.scan(step, begin, stages, reverse=True)
    if own_elimination:  # all stages at once
        eye = jnp.eye(pivot.shape[1], dtype=pivot.dtype)
        inverse = jax.vmap(lambda a: _eliminate(a, eye))(pivot)
    else:
        inverse = jnp.linalg.inv(pivot)
    return _Recursion(value, gain, inverse, back)


def _library_product(a: Array, b: Array) -> Array:
    return a @ b


def _fused_product(a: Array, b: Array) -> Array:
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


@custom_vmap
def _recursion(hxx: Array, direct: Array, transition: Array, rho: Array) -> _Recursion:
    """One game: where matrices are small, products are fused into the surrounding arithmetic."""
    small = transition.shape[2] <= SMALL_STAGE
    product = _fused_product if small else _library_product
    return _riccati(hxx, direct, transition, rho, product, small)


@_recursion.def_vmap
def _recursion_batched(
    size: int, batched: list[bool], *arguments: Array
) -> tuple[_Recursion, _Recursion]:
    """Many games at once: a batched library product beats the fused one.

    LAPACK is left out: its batched calls from two threads at once make jaxlib (0.10) wait for ever.
    """

    def one(hxx: Array, direct: Array, transition: Array, rho: Array) -> _Recursion:
        return _riccati(hxx, direct, transition, rho, _library_product, True)

    axes = tuple(0 if b else None for b in batched)
    found = jax.vmap(one, in_axes=axes, axis_size=size)(*arguments)
    return found, _Recursion(True, True, True, True)  # type: ignore[arg-type]


def _eliminate(matrix: Float[Array, "m m"], right: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """`matrix^-1 right` by Gauss-Jordan elimination without row exchanges.

    The order (controls, then row multipliers) keeps pivots away from 0: controls carry the players'
    own curvature, and multipliers a softness that is never negative (Vanderbei, SIAM J. Optim. 5,
    1995). What rounding is left, Newton's iteration corrects.
    """
    size = matrix.shape[0]
    both = jnp.concatenate([matrix, right], axis=1)
    rows = np.arange(size)[:, None]
    for k in range(size):
        pivot = both[k] / both[k, k]
        both = jnp.where(rows == k, pivot[None], both - both[:, k : k + 1] * pivot[None])
    return both[:, size:]
