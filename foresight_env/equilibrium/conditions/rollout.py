"""Rollouts of controls: open loop, and with a Newton step's own feedback."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.identical_players import apart, moving_alike
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.types import AnyArray, StageNumber


def next_state(layout: Layout, t: StageNumber, x: Array, u: Array) -> Array:
    """Joint state (n,) that controls (m,) of stage `t` lead to."""
    nexts = []
    for members in moving_alike(layout.game):
        move = partial(layout.game.players[members.start].dynamics, t)
        states, controls = layout.state_slices, layout.control_slices
        following = jax.vmap(move)(apart(x, states, members), apart(u, controls, members))
        nexts.append(following.ravel())
    return jnp.concatenate(nexts)


def rollout(
    layout: Layout, initial_state: Float[AnyArray, "n"], u: Float[AnyArray, "T m"]
) -> Float[Array, "T n"]:
    """States that controls lead to."""

    def step(x, stage):
        t, control = stage
        x = next_state(layout, t, x, control)
        return x, x

    _, x = jax.lax.scan(step, initial_state, (jnp.arange(1, layout.game.horizon + 1), u))
    return x


def feedback_rollout(
    layout: Layout,
    previous: Float[Array, "T n"],
    u: Float[Array, "T m"],
    dx: Float[Array, "T n"],
    du: Float[Array, "T m"],
    gain: Float[Array, "T m n"],
    length: Float[Array, ""],
) -> tuple[Float[Array, "T n"], Float[Array, "T m"]]:
    """Return states and controls after the closed-loop rollout of a Newton step.

    The step says `du = gain dx + k`. Along the nonlinear dynamics states differ from the linear
    `x + dx`; the gain corrects for the difference, as in differential dynamic programming
    (Jacobson and Mayne, 1970). Controls stay within their bounds.
    """
    before = jnp.concatenate([jnp.zeros_like(dx[:1]), dx[:-1]])
    forward = length * (du - jnp.einsum("tmn,tn->tm", gain, before))
    low, high = (jnp.asarray(b[:, layout.n :]) for b in layout.bounds)

    def step(x, stage):
        t, old_x, old_u, k, matrix, least, most = stage
        control = jnp.clip(old_u + k + matrix @ (x - old_x), least, most)
        x = next_state(layout, t, x, control)
        return x, (x, control)

    stages = (
        jnp.arange(1, layout.game.horizon + 1),
        previous,
        u,
        forward,
        gain,
        low,
        high,
    )
    return jax.lax.scan(step, previous[0], stages)[1]
