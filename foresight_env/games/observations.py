"""Observation models: `y_t ~ Normal(h(x_t), Sigma_t)` (paper, section IV)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.types import States


@dataclass(frozen=True)
class ObservationModel:
    """Sensor: `function(states) -> (size,)`, states being one vector per player.

    `owners[k]` is the player that entry k belongs to (an unobserved agent leaves its entries
    out), or None for an entry that concerns several.
    """

    function: Callable[[States], Float[Array, "size"]]
    owners: tuple[int | None, ...]

    @property
    def size(self) -> int:
        """Number of entries of one observation."""
        return len(self.owners)

    def __call__(self, states: States) -> Float[Array, "size"]:
        return self.function(states)


@dataclass(frozen=True)
class _Leading:
    counts: tuple[int, ...]

    def __call__(self, states: States) -> Float[Array, "size"]:
        return jnp.concatenate([x[:k] for x, k in zip(states, self.counts, strict=True)])


def _leading(counts: tuple[int, ...]) -> ObservationModel:
    owners = tuple(i for i, k in enumerate(counts) for _ in range(k))
    return ObservationModel(_Leading(counts), owners)


def full_state(state_sizes: tuple[int, ...]) -> ObservationModel:
    """Return the observation model `h(x) = x`: every player's whole state.

    Args:
        state_sizes: of the players (`Game.state_sizes`).

    Returns:
        The model; its observations have shape (n,), the players' states one after the other.
    """
    return _leading(tuple(state_sizes))


def positions(state_sizes: tuple[int, ...]) -> ObservationModel:
    """Return the observation model `h(x) = (p^1, ..., p^N)`: every player's position.

    Args:
        state_sizes: of the players (`Game.state_sizes`); a state begins with the position.

    Returns:
        The model; its observations have shape (2 N,), m.
    """
    return _leading((2,) * len(state_sizes))
