"""LSTM that pools its neighbours' states (Alahi et al., "Social LSTM", CVPR 2016).

Neighbours are pooled by the maximum of a small network's outputs (Gupta et al., "Social
GAN", CVPR 2018), not over a grid: their places are not rounded to cells.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from agents.learned.features import Features
from agents.learned.head import Futures, Head


class SocialLstm(eqx.Module):
    """One recurrent network for all agents."""

    memory: eqx.nn.LSTMCell
    neighbour: eqx.nn.MLP
    head: Head
    width: int = eqx.field(static=True)

    def __init__(self, width: int = 64, modes: int = 1, *, key: PRNGKeyArray) -> None:
        first, second, third = jax.random.split(key, 3)
        self.memory = eqx.nn.LSTMCell(7, width, key=first)
        self.neighbour = eqx.nn.MLP(6 + width, width, width, 1, activation=jax.nn.gelu, key=second)
        self.head = Head(2 * width + 2, modes, key=third)
        self.width = width

    def __call__(self, seen: Features) -> Futures:
        """Futures of all agents."""
        kind = jnp.asarray(seen.kind)

        def remember(past: jax.Array, own: jax.Array) -> jax.Array:
            def step(state: tuple[jax.Array, jax.Array], row: jax.Array):
                found = self.memory(jnp.concatenate([row, own]), state)
                # Unobserved agents have no influence.
                kept = jax.tree.map(lambda a, b: jnp.where(row[-1] > 0.0, a, b), found, state)
                return kept, None

            blank = jnp.zeros(self.width)
            return jax.lax.scan(step, (blank, blank), past)[0][0]

        memory = jax.vmap(remember)(jnp.asarray(seen.past), kind)
        there = jnp.asarray(seen.there)
        count = len(there)

        def pooled(i: jax.Array, others: jax.Array) -> jax.Array:
            told = jax.vmap(lambda o, m: self.neighbour(jnp.concatenate([o, m])))(others, memory)
            counted = there & (jnp.arange(count) != i)
            return jnp.max(jnp.where(counted[:, None], jax.nn.relu(told), 0.0), axis=0)

        social = jax.vmap(pooled)(jnp.arange(count), jnp.asarray(seen.others))
        return self.head(jnp.concatenate([memory, social, kind], axis=1), there, kind)
