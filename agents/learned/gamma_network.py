"""Amortised inference of discount factors from a window of observations.

A network trained on simulated episodes replaces the solves of the inverse game (Papamakarios and
Murray, "Fast epsilon-free inference of simulation models with
Bayesian conditional density estimation", NeurIPS 2016, with one Gaussian).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, PRNGKeyArray

WINDOW = 10
"""Observations, as many as the online estimator has."""


class GammaExample(NamedTuple):
    """A window of a crosswalk of two, in which the other's discount factor is asked for."""

    own: Float32[np.ndarray, "window 4"]
    """Observed states of the one whose gamma it is: places from its place now (m), m/s."""
    other: Float32[np.ndarray, "window 4"]
    """And of the ego, from the same place."""
    gamma: Float32[np.ndarray, ""]


class GammaNetwork(eqx.Module):
    """Mean and deviation of a discount factor."""

    layers: eqx.nn.MLP

    def __init__(self, width: int = 128, *, key: PRNGKeyArray) -> None:
        self.layers = eqx.nn.MLP(2 * WINDOW * 4, 2, width, 3, activation=jax.nn.gelu, key=key)

    def __call__(self, own: Any, other: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Mean between 0 and 1, and standard deviation."""
        raw = self.layers(jnp.concatenate([jnp.ravel(own), jnp.ravel(other)]))
        return jax.nn.sigmoid(raw[0]), 0.01 + 0.5 * jax.nn.sigmoid(raw[1])


def gamma_loss(network: GammaNetwork, example: GammaExample) -> tuple[Array, Array]:
    """Negative log-likelihood of the truth."""
    mean, deviation = network(example.own, example.other)
    error = (jnp.asarray(example.gamma) - mean) / deviation
    return 0.5 * error**2 + jnp.log(deviation), jnp.ones(())


def gamma_window(
    rows: Float[np.ndarray, "window 2 4"],
) -> tuple[Float32[np.ndarray, "window 4"], Float32[np.ndarray, "window 4"]]:
    """Features of the ego (row 0) and of the pedestrian (row 1)."""
    origin = np.array([*rows[-1, 1, :2], 0.0, 0.0])
    return np.asarray(rows[:, 1] - origin, np.float32), np.asarray(rows[:, 0] - origin, np.float32)


def gamma_examples(
    observed: Float[np.ndarray, "steps 2 4"], gamma: Float[np.ndarray, "2"]
) -> list[GammaExample]:
    """Every second window of an episode; the ego, whose gamma is always the same, is not asked."""
    truth = np.asarray(gamma[1], np.float32)
    return [
        GammaExample(*gamma_window(observed[end - WINDOW : end]), truth)
        for end in range(WINDOW, len(observed) + 1, 2)
    ]
