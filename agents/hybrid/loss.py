"""Loss of joint futures: displacement of the central and of the best future, and likelihood."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from agents.hybrid.futures import GameUse, JointFutures, deviations, joint_futures
from agents.hybrid.scene import Scene
from agents.hybrid.smooth_game import positions
from agents.hybrid.strategies import GAME_BASIS, STEPS

OTHERS_SHARE = 0.05
"""Share of all futures in the loss of the best, so that none is left without a gradient."""
FINAL_WEIGHT = 0.5
"""Of the displacement at the last step, relative to the mean one."""
LIKELIHOOD_WEIGHT = 0.2
CHOICE_WEIGHT = 0.1
CHOICE_LENGTH = 0.2
"""m; futures that are worse than the best by more are not to be chosen."""
VEHICLE_WEIGHT = 3.0
"""Of a vehicle relative to a person: recordings have few vehicles."""


class Example(NamedTuple):
    """A scene and what followed."""

    scene: Scene
    target: Float[np.ndarray, "*b A steps 2"]
    """m, relative to the scene's middle."""
    known: Bool[np.ndarray, "*b A steps"]


def futures_loss(network: Any, example: Example, use: GameUse) -> tuple[Array, Array]:
    """Return the loss of a scene, summed over agents, and how many agents it counts for."""
    found = joint_futures(network, example.scene, use)
    frames, known = example.scene.frames, jnp.asarray(example.known)
    target = jnp.asarray(example.target)
    path = jax.vmap(lambda z: positions(frames, z, GAME_BASIS))(found.strategy)
    error = target - path
    distance = jnp.sqrt(jnp.sum(error**2, axis=-1) + 1e-6)
    steps = jnp.maximum(known.sum(axis=1), 1)
    counted = known.any(axis=1)
    mean = jnp.sum(jnp.where(known, distance, 0.0), axis=-1) / steps
    last = jnp.argmax(jnp.where(known, jnp.arange(STEPS), -1), axis=1)
    final = jnp.take_along_axis(distance, last[None, :, None], axis=2)[..., 0]
    missed = mean + FINAL_WEIGHT * final
    best = (1.0 - OTHERS_SHARE) * missed.min(axis=0) + OTHERS_SHARE * missed.mean(axis=0)
    likelihood = negative_log_likelihood(found, example)
    wanted = jax.nn.softmax(jax.lax.stop_gradient(-missed / CHOICE_LENGTH), axis=0)
    choice = -jnp.sum(wanted * found.own, axis=0)
    whole = missed[0] + best + LIKELIHOOD_WEIGHT * likelihood + CHOICE_WEIGHT * choice
    weight = jnp.where(example.scene.bodies.vehicle, VEHICLE_WEIGHT, 1.0) * counted
    return jnp.sum(weight * jnp.where(counted, whole, 0.0)), jnp.sum(weight)


def negative_log_likelihood(
    found: JointFutures, example: Example, factor: float = 1.0
) -> Float[Array, "A"]:
    """Return each agent's mean over its known steps of `-log p(truth)`, p a mixture of Gaussians.

    Places of futures count as given: only probabilities and deviations have derivatives.

    Args:
        found: the scene's futures.
        example: the scene.
        factor: of all deviations.
    """
    frames, known = example.scene.frames, jnp.asarray(example.known)
    path = jax.vmap(lambda z: positions(frames, z, GAME_BASIS))(found.strategy)
    error = jax.lax.stop_gradient(jnp.asarray(example.target) - path)
    # In each agent's axes.
    own = jnp.einsum("aik,mati->matk", jnp.asarray(frames.rotation), error)
    spread = factor * deviations(found.spread, GAME_BASIS)
    density = jnp.sum(-0.5 * (own / spread) ** 2 - jnp.log(spread), axis=-1) - jnp.log(2.0 * jnp.pi)
    mixture = jax.nn.logsumexp(density + found.logits[:, None, None], axis=0)
    return -jnp.sum(jnp.where(known, mixture, 0.0), axis=1) / jnp.maximum(known.sum(axis=1), 1)
