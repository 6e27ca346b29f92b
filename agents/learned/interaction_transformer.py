"""Attention between agents (in short what Ngiam et al., "Scene Transformer", ICLR 2022, do).

Each agent's track is one token in its own frame; how two agents stand to each other enters the
attention between them, so that no frame is preferred.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from agents.learned.features import KNOWN, Features
from agents.learned.head import Futures, Head


class Block(eqx.Module):
    """Attention whose scores and values know the pair, then a layer per agent."""

    query: eqx.nn.Linear
    pair: eqx.nn.MLP
    score: eqx.nn.Linear
    mix: eqx.nn.MLP
    first: eqx.nn.LayerNorm
    second: eqx.nn.LayerNorm
    heads: int = eqx.field(static=True)

    def __init__(self, width: int, heads: int, *, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 4)
        self.query = eqx.nn.Linear(width, width, key=keys[0])
        self.pair = eqx.nn.MLP(width + 6, width, width, 1, activation=jax.nn.gelu, key=keys[1])
        self.score = eqx.nn.Linear(width, width, use_bias=False, key=keys[2])
        self.mix = eqx.nn.MLP(width, width, 2 * width, 1, activation=jax.nn.gelu, key=keys[3])
        self.first, self.second = eqx.nn.LayerNorm(width), eqx.nn.LayerNorm(width)
        self.heads = heads

    def __call__(self, tokens: Array, others: Array, there: Array) -> Array:
        """Tokens (A, width), each after a look at the others."""
        count, width = tokens.shape
        normal = jax.vmap(self.first)(tokens)

        def attend(token: Array, pairs: Array) -> Array:
            value = jax.vmap(lambda o, other: self.pair(jnp.concatenate([other, o])))(pairs, normal)
            asked = self.query(token).reshape(self.heads, -1)
            keys = jax.vmap(self.score)(value).reshape(count, self.heads, -1)
            scores = jnp.einsum("hd,ahd->ha", asked, keys) / np.sqrt(width / self.heads)
            weights = jax.nn.softmax(jnp.where(there[None], scores, -1e9), axis=1)
            values = value.reshape(count, self.heads, -1)
            return jnp.einsum("ha,ahd->hd", weights, values).ravel()

        tokens = tokens + jax.vmap(attend)(normal, others)
        return tokens + jax.vmap(self.mix)(jax.vmap(self.second)(tokens))


class InteractionTransformer(eqx.Module):
    """Tracks in, K joint futures out."""

    embed: eqx.nn.MLP
    blocks: tuple[Block, ...]
    head: Head

    def __init__(
        self, width: int = 64, modes: int = 5, depth: int = 2, heads: int = 4, *, key: PRNGKeyArray
    ) -> None:
        first, last, *rest = jax.random.split(key, depth + 2)
        self.embed = eqx.nn.MLP(KNOWN * 5 + 2, width, width, 2, activation=jax.nn.gelu, key=first)
        self.blocks = tuple(Block(width, heads, key=k) for k in rest)
        self.head = Head(width, modes, key=last)

    def __call__(self, seen: Features) -> Futures:
        """Futures of all agents."""
        past, kind = jnp.asarray(seen.past), jnp.asarray(seen.kind)
        there, others = jnp.asarray(seen.there), jnp.asarray(seen.others)
        flat = jnp.concatenate([past.reshape(len(past), -1), kind], axis=1)
        tokens = jax.vmap(self.embed)(flat)
        for block in self.blocks:
            tokens = block(tokens, others, there)
        return self.head(tokens, there, kind)
