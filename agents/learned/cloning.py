"""Behaviour cloning of the oracle by a network (Pomerleau, 1989)."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, PRNGKeyArray

from agents.learned.crosswalk_window import SIZE, WINDOW, crosswalk_window
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT


class CloningExample(NamedTuple):
    """Observations and the oracle's control."""

    seen: Float32[np.ndarray, "window 10"]
    """See `crosswalk_window`."""
    control: Float32[np.ndarray, "2"]
    """m/s^2."""


class CloningNetwork(eqx.Module):
    """From observations to a control."""

    layers: eqx.nn.MLP

    def __init__(self, width: int = 128, *, key: PRNGKeyArray) -> None:
        self.layers = eqx.nn.MLP(WINDOW * SIZE, 2, width, 3, activation=jax.nn.gelu, key=key)

    def __call__(self, seen: Any) -> Float[Array, "2"]:
        """Accelerations, m/s^2."""
        found: Array = CONTROL_LIMIT * jnp.tanh(self.layers(jnp.ravel(seen)))
        return found


def cloning_loss(network: CloningNetwork, example: CloningExample) -> tuple[Array, Array]:
    """Huber loss, so that controls at their limits do not dominate."""
    error = network(example.seen) - jnp.asarray(example.control)
    size = jnp.abs(error)
    return jnp.sum(jnp.where(size < 1.0, 0.5 * error**2, size - 0.5)), jnp.ones(())


def cloning_examples(
    observations: Float[np.ndarray, "steps 10"], controls: Float[np.ndarray, "steps 2"]
) -> list[CloningExample]:
    """Every step of an episode."""
    return [
        CloningExample(crosswalk_window(observations[: k + 1]), np.asarray(control, np.float32))
        for k, control in enumerate(controls)
    ]
