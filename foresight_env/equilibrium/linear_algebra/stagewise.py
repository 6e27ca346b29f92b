"""Newton's linear system by a recursion over stages: linear in the horizon (a coupled Riccati).

Solves, for all stages t and given right-hand sides,

    dq_t = Hxx dx_{t+1} + Hxu du_t + r_x + rho_{t+1} d(A_{t+1}' q_{t+1}),
    0    = Hux dx_{t+1} + Huu du_t + B_t' dq_t + d(B_t)' q_t + r_u,
    dx_{t+1} = A_t dx_t + B_t du_t + d_t,

whose solution has the form `du_t = K_t dx_t + k_t`, `dq_t = P_t dx_{t+1} + Hxu du_t + p_t`. H is
not symmetric: its rows belong to different players.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.linear_algebra.recursion import affine_recursion
from foresight_env.equilibrium.linear_algebra.riccati import matrix_recursion
from foresight_env.equilibrium.linear_algebra.small_matrices import matrix_product
from foresight_env.equilibrium.linear_algebra.transitions import EqualSizes


class StageSystem(NamedTuple):
    """Matrices of the linear system, per stage."""

    hessian: Float[Array, "T w w"]
    dynamics_hessian: Float[Array, "T w w"] | None
    """Second derivatives of `q_t' f` by (x_t, u_t); None where all dynamics are linear."""
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    rho: Float[Array, "T n"]


class Factor(NamedTuple):
    """Factorisation that vector solves reuse."""

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
    """Coefficient of `du_t` in the condition of `x_t`, times `inverse`."""
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    rho: Float[Array, "T n"]


def factorise(system: StageSystem, sizes: EqualSizes | None) -> Factor:
    """Backward matrix recursion; `sizes`: the players' common ones (`Layout.equal_sizes`).

    With them products with large `a` and `b`, which must then be block-diagonal, are block by
    block.
    """
    n = system.a.shape[1]
    transition = jnp.concatenate([system.a, system.b], axis=2)
    x_rows = jnp.concatenate([jnp.zeros_like(system.a), system.hessian[:, :n, n:]], axis=2)
    u_rows = matrix_product(system.hessian[:, n:, :n], transition)
    own = (jnp.zeros_like(system.hessian[:, n:, :n]), system.hessian[:, n:, n:])
    u_rows = u_rows + jnp.concatenate(own, axis=2)
    direct = jnp.concatenate([jnp.zeros_like(x_rows), u_rows], axis=1)
    if system.dynamics_hessian is not None:
        direct = direct + system.dynamics_hessian
    value, gain, inverse, back = matrix_recursion(sizes)(
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
    initial_change: Float[Array, "n"],
) -> tuple[Float[Array, "T n"], Float[Array, "T m"]]:
    """`dx_{t+1}` and `du_t` for one right-hand side.

    `vmap` over several.
    """
    transposed = jnp.swapaxes(factor.b, 1, 2)
    fixed = _times(factor.left, defect) + _times(transposed, r_x) + r_u
    pushed = _times(jnp.swapaxes(factor.a, 1, 2), _times(factor.value, defect) + r_x)
    offset = factor.rho * (pushed - _times(factor.back, fixed))
    # y_t: what stages after t add to p_t; none after the last one.
    later = affine_recursion(factor.adjoint, offset, jnp.zeros_like(initial_change), reverse=True)
    y = jnp.concatenate([later[1:], jnp.zeros_like(later[:1])])
    wanted = fixed + _times(transposed, y)
    moved = defect - _times(factor.b, _times(factor.inverse, wanted))
    dx = affine_recursion(factor.closed, moved, initial_change)
    before = jnp.concatenate([initial_change[None], dx[:-1]])
    return dx, _times(factor.gain, before) - _times(factor.inverse, wanted)


def _times(matrices: Float[Array, "T a b"], vectors: Float[Array, "T b"]) -> Float[Array, "T a"]:
    return jnp.sum(matrices * vectors[:, None, :], axis=2)
