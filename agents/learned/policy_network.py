"""Network that PPO trains (Schulman et al., 2017): Stable-Baselines3's actor without PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from agents.learned.crosswalk_window import SIZE, WINDOW
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT

SCALE = 0.3
"""Of what it is given, 1/m: a few metres are to be about 1."""
WIDTH = 64
"""Of its two hidden layers."""


class PolicyNetwork(eqx.Module):
    """From observations to the mean of the controls."""

    layers: eqx.nn.MLP

    def __init__(self, *, key: PRNGKeyArray) -> None:
        self.layers = eqx.nn.MLP(WINDOW * SIZE, 2, WIDTH, 2, activation=jnp.tanh, key=key)

    def __call__(self, seen: Any) -> Float[Array, "2"]:
        """Accelerations, m/s^2."""
        found: Array = CONTROL_LIMIT * jnp.clip(self.layers(SCALE * jnp.ravel(seen)), -1.0, 1.0)
        return found


ACTOR = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
"""Stable-Baselines3's names of its layers, from the first to the last."""


def policy_network(weights: Mapping[str, np.ndarray]) -> PolicyNetwork:
    """The actor of Stable-Baselines3's `MlpPolicy`, from the arrays of its `state_dict`."""
    network = PolicyNetwork(key=jax.random.key(0))
    for k, name in enumerate(ACTOR):
        values = (jnp.asarray(weights[f"{name}.weight"]), jnp.asarray(weights[f"{name}.bias"]))
        network = eqx.tree_at(_layer(k), network, values)
    return network


def _layer(k: int) -> Any:
    return lambda network: (network.layers.layers[k].weight, network.layers.layers[k].bias)
