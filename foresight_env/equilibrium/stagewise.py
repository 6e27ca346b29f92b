"""Newton's linear system by a recursion over stages: linear in the horizon (a coupled Riccati).

Solves, for all stages t and given right-hand sides,

    dq_t = Hxx dx_{t+1} + Hxu du_t + r_x + rho_{t+1} d(A_{t+1}' q_{t+1}),
    0    = Hux dx_{t+1} + Huu du_t + B_t' dq_t + d(B_t)' q_t + r_u,
    dx_{t+1} = A_t dx_t + B_t du_t + d_t,

whose solution has the form `du_t = K_t dx_t + k_t`, `dq_t = P_t dx_{t+1} + Hxu du_t + p_t`. H is
not symmetric: its rows belong to different players.
"""

from __future__ import annotations

import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from foresight_env.equilibrium.recursion import affine_recursion


class StageSystem(NamedTuple):
    """Matrices of the linear system, per stage."""

    hessian: Float[Array, "T w w"]
    dynamics_hessian: Float[Array, "T w w"] | None
    """Second derivatives of `q_t' f` by (x_t, u_t); None where all dynamics are linear."""
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
    """What `du_t` puts into the condition of `x_t`, times `inverse`."""
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
PIVOTS = 2
"""Variables eliminated at a time: half the passes over a stage's matrix of one at a time."""


def factorise(system: StageSystem) -> Factor:
    """Backward matrix recursion."""
    n = system.a.shape[1]
    transition = jnp.concatenate([system.a, system.b], axis=2)
    x_rows = jnp.concatenate([jnp.zeros_like(system.a), system.hessian[:, :n, n:]], axis=2)
    u_rows = matrix_product(system.hessian[:, n:, :n], transition)
    own = (jnp.zeros_like(system.hessian[:, n:, :n]), system.hessian[:, n:, n:])
    u_rows = u_rows + jnp.concatenate(own, axis=2)
    direct = jnp.concatenate([jnp.zeros_like(x_rows), u_rows], axis=1)
    if system.dynamics_hessian is not None:
        direct = direct + system.dynamics_hessian
    value, gain, inverse, back = _recursion(
        system.hessian[:, :n, :n], x_rows, direct, transition, system.rho
    )
    transposed = jnp.swapaxes(system.b, 1, 2)
    return Factor(
        gain,
        inverse,
        system.hessian[:, n:, :n] + matrix_product(transposed, value),
        value,
        system.a + matrix_product(system.b, gain),
        system.rho[:, :, None] * (jnp.swapaxes(system.a, 1, 2) - matrix_product(back, transposed)),
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
    first: int,
) -> tuple[Float[Array, "T n"], Float[Array, "T c"], Float[Array, "T k"]]:
    """`dx_{t+1}`, the `first` entries of `du_t` and the others, for one right-hand side.

    `vmap` over several.
    """
    transposed = jnp.swapaxes(factor.b, 1, 2)
    fixed = _times(factor.left, defect) + _times(transposed, r_x) + r_u
    pushed = _times(jnp.swapaxes(factor.a, 1, 2), _times(factor.value, defect) + r_x)
    offset = factor.rho * (pushed - _times(factor.back, fixed))
    # y_t: what stages after t add to p_t; none after the last one.
    later = affine_recursion(factor.adjoint, offset, jnp.zeros_like(dx0), reverse=True)
    y = jnp.concatenate([later[1:], jnp.zeros_like(later[:1])])
    wanted = fixed + _times(transposed, y)
    moved = defect - _times(factor.b, _times(factor.inverse, wanted))
    dx = affine_recursion(factor.closed, moved, dx0)
    before = jnp.concatenate([dx0[None], dx[:-1]])

    def entries(rows: slice) -> Array:
        # Matrices are cut, not the vectors that they make: XLA's CPU back-end (jaxlib 0.8 to 0.10,
        # AVX2) reads wrong entries of a fused vector of 6 that is cut to 4.
        return _times(factor.gain[:, rows], before) - _times(factor.inverse[:, rows], wanted)

    return dx, entries(slice(0, first)), entries(slice(first, None))


def _times(matrices: Float[Array, "T a b"], vectors: Float[Array, "T b"]) -> Float[Array, "T a"]:
    return jnp.sum(matrices * vectors[:, None, :], axis=2)


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


def _riccati(
    hxx: Array, x_rows: Array, direct: Array, transition: Array, rho: Array, own_elimination: bool
) -> _Recursion:
    n = hxx.shape[1]

    def step(carry: Array, stage: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        h, above, below, z, r = stage
        p = h + carry
        block = matrix_product(z.T, matrix_product(p, z) + above) + below
        if own_elimination:
            reduced = _eliminate(block, n)
        else:
            reduced = block[:n, :n] - block[:n, n:] @ jnp.linalg.solve(block[n:, n:], block[n:, :n])
        return r[:, None] * reduced, (p, block)

    begin = jnp.zeros((n, n), hxx.dtype)
    stages = (hxx, x_rows, direct, transition, rho)
    _, (value, block) = jax.lax.scan(step, begin, stages, reverse=True)
    pivot, right = block[:, n:, n:], block[:, n:, :n]
    inverse = _inverse(pivot) if own_elimination else jnp.linalg.inv(pivot)
    back = matrix_product(block[:, :n, n:], inverse)
    return _Recursion(value, -matrix_product(inverse, right), inverse, back)


@custom_vmap
def _recursion(
    hxx: Array, x_rows: Array, direct: Array, transition: Array, rho: Array
) -> _Recursion:
    """One game: where matrices are small, products are fused into the surrounding arithmetic."""
    small = transition.shape[2] <= SMALL_STAGE
    return _riccati(hxx, x_rows, direct, transition, rho, small)


@_recursion.def_vmap
def _recursion_batched(
    size: int, batched: list[bool], *arguments: Array
) -> tuple[_Recursion, _Recursion]:
    """Many games at once.

    LAPACK is left out: its batched calls from two threads at once make jaxlib (0.10) wait for ever.
    """

    def one(hxx: Array, x_rows: Array, direct: Array, transition: Array, rho: Array) -> _Recursion:
        return _riccati(hxx, x_rows, direct, transition, rho, True)

    axes = tuple(0 if b else None for b in batched)
    found = jax.vmap(one, in_axes=axes, axis_size=size)(*arguments)
    return found, _Recursion(True, True, True, True)  # type: ignore[arg-type]


def _eliminate(block: Float[Array, "*b w w"], first: int) -> Float[Array, "*b n n"]:
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


def _inverse(matrix: Float[Array, "*b m m"]) -> Float[Array, "*b m m"]:
    """Inverse by Gauss-Jordan elimination in the same order as `_eliminate`."""
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
