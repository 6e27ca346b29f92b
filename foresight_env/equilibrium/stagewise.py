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

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


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
    inverse: Float[Array, "T m m"]
    left: Float[Array, "T m n"]
    back: Float[Array, "T n m"]
    value: Float[Array, "T n n"]
    a: Float[Array, "T n n"]
    b: Float[Array, "T n m"]
    rho: Float[Array, "T n"]


def factorise(system: StageSystem) -> Factor:
    """Backward matrix recursion."""
    n = system.a.shape[1]

    def step(carry, s):
        h, f, a, b, rho = s
        p = h[:n, :n] + carry
        left = h[n:, :n] + b.T @ p
        back_u = p @ b + h[:n, n:]
        inverse = jnp.linalg.inv(h[n:, n:] + f[n:, n:] + b.T @ h[:n, n:] + left @ b)
        gain = -inverse @ (left @ a + f[n:, :n])
        back = a.T @ back_u + f[:n, n:]
        carry = rho[:, None] * (a.T @ p @ a + f[:n, :n] + back @ gain)
        return carry, (gain, inverse, left, back, p)

    zero = jnp.zeros((n, n), system.hessian.dtype)
    _, (gain, inverse, left, back, value) = jax.lax.scan(
        step, zero, (*system[:2], system.a, system.b, system.rho), reverse=True
    )
    return Factor(gain, inverse, left, back, value, system.a, system.b, system.rho)


def solve_stages(
    factor: Factor,
    r_x: Float[Array, "T n"],
    r_u: Float[Array, "T m"],
    defect: Float[Array, "T n"],
    dx0: Float[Array, "n"],
) -> tuple[Float[Array, "T n"], Float[Array, "T m"]]:
    """`dx_{t+1}`, `du_t` for one right-hand side; `vmap` over several."""

    def backward(y, s):
        rx, ru, d, inverse, left, back, value, a, b, rho = s
        p = rx + y
        k = -inverse @ (left @ d + b.T @ p + ru)
        return rho * (a.T @ (value @ d + p) + back @ k), k

    _, offsets = jax.lax.scan(
        backward,
        jnp.zeros_like(r_x[0]),
        (r_x, r_u, defect, factor.inverse, factor.left, factor.back, factor.value, factor.a,
         factor.b, factor.rho),
        reverse=True,
    )  # fmt: skip

    def forward(dx, s):
        gain, k, a, b, d = s
        du = gain @ dx + k
        dx = a @ dx + b @ du + d
        return dx, (dx, du)

    _, (dx, du) = jax.lax.scan(forward, dx0, (factor.gain, offsets, factor.a, factor.b, defect))
    return dx, du
