"""Output of both networks: K joint futures as departures from straight motion, with deviations."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from agents.learned.features import AHEAD, STEP

LEAST_DEVIATION = 0.02
"""m; no future is more certain."""


class Futures(NamedTuple):
    """Of A agents in their own frames; future k is one of all agents together."""

    departure: Float[Array, "K A ahead 2"]
    """From going straight on, m."""
    deviation: Float[Array, "K A ahead 2"]
    """Standard deviations along and across the way, m."""
    logits: Float[Array, "K"]


class Head(eqx.Module):
    """From a network's features of each agent to `Futures`."""

    layer: eqx.nn.MLP
    modes: int = eqx.field(static=True)

    def __init__(self, width: int, modes: int, *, key: PRNGKeyArray) -> None:
        size = modes * (AHEAD * 4 + 1)
        self.layer = eqx.nn.MLP(width, size, width, 1, activation=jax.nn.gelu, key=key)
        self.modes = modes

    def __call__(
        self, known: Float[Array, "A width"], there: Array, kind: Float[Array, "A 2"]
    ) -> Futures:
        """Departures grow with time from nothing, in the unit that speeds give."""
        raw = jax.vmap(self.layer)(known)
        numbers, logits = raw[:, : -self.modes], raw[:, -self.modes :]
        parts = numbers.reshape(len(known), self.modes, AHEAD, 4).swapaxes(0, 1)
        times = STEP * jnp.arange(1, AHEAD + 1)[:, None]
        unit = times * (0.3 + 0.1 * kind[:, 1])[None, :, None, None]
        spread = LEAST_DEVIATION + unit * jax.nn.softplus(parts[..., 2:])
        # Of the scene as a whole: all agents decide which future it is.
        say = jnp.sum(jnp.where(there[:, None], logits, 0.0), axis=0)
        return Futures(unit * parts[..., :2], spread, say)


def negative_log_likelihood(
    futures: Futures, target: Float[Array, "A ahead 2"], known: Array
) -> tuple[Array, Array]:
    """Of a scene, of all agents and steps together, and how many of those there are.

    A mixture over joint futures (Casas et al., "Implicit latent variable model", ECCV 2020, in
    short): the logarithm of the sum is over the product of all agents' densities.
    """
    error = (target[None] - futures.departure) / futures.deviation
    density = -0.5 * error**2 - jnp.log(futures.deviation) - 0.5 * jnp.log(2.0 * jnp.pi)
    joint = jnp.sum(jnp.where(known[None, ..., None], density, 0.0), axis=(1, 2, 3))
    weights = jax.nn.log_softmax(futures.logits)
    return -jax.nn.logsumexp(weights + joint), jnp.sum(known)


Network = Any
"""An equinox module: `Features` to `Futures`."""
