"""Inverse game on a scene's window: the evidence of traits, and traits that explain it better.

The game that was played from the window's first step: agents preferred a motion of constant
velocity, and equilibrium motion is what was observed, up to noise. A fixed number of Gauss-Newton
steps on preferred velocities and traits, from the network's proposal and with its own prior.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agents.hybrid.network import traits_of
from agents.hybrid.scene import Scene
from agents.hybrid.smooth_game import SmoothGame, equilibrium, positions
from agents.hybrid.strategies import GAME_BASIS
from agents.learned.features import KNOWN, STEP

OBSERVED = KNOWN - 1
"""Steps of the game in the window."""
LAYERS = 2
"""Gauss-Newton steps."""
VELOCITY_DEVIATION = 1.0
"""Of the prior of preferred velocities about the mean one, m/s."""
TRAIT_DEVIATION = 1.0
"""Of the prior of the numbers that traits are made of."""
STRAIGHT = np.linalg.lstsq(GAME_BASIS.value, GAME_BASIS.times, rcond=None)[0].astype(np.float32)
"""Coefficients of a motion of 1 m/s."""


class Explained(NamedTuple):
    """Traits corrected by a window, and their evidence."""

    numbers: Float[Array, "A 4"]
    """Corrected numbers of traits."""
    deviation: Float[Array, "A 4"]
    """Standard deviations of them."""
    evidence: Float[Array, ""]
    """Logarithm of the window's likelihood, over which parameters are integrated (Laplace)."""


def explained(
    scene: Scene, numbers: Float[Array, "A 4"], noise: Float[Array, ""], infer: bool = True
) -> Explained:
    """Return what the window says of traits, given as the unbounded numbers of `traits_of`.

    Args:
        scene: agents that were not observed throughout its window take no part.
        numbers: the proposal.
        noise: standard deviation of observations, m.
        infer: whether discount factors are inferred; else they are 1.
    """
    followed = jnp.asarray(scene.followed)
    seen = jnp.where(followed[:, None, None], jnp.asarray(scene.window), 0.0)[:, 1:]
    mean = (seen[:, -1] - jnp.asarray(scene.start.place)) / (OBSERVED * STEP)
    rotation = jnp.asarray(scene.start.rotation)
    change = jnp.einsum("aik,ai->ak", rotation, mean - jnp.asarray(scene.start.velocity))
    bodies = scene.bodies._replace(there=followed)

    def residual(parameters: Float[Array, "A 6"]) -> Float[Array, "A observed 2"]:
        wanted = jnp.asarray(STRAIGHT)[None, :, None] * parameters[:, None, :2]
        game = SmoothGame(scene.start, bodies, traits_of(parameters[:, 2:], infer), wanted)
        path = positions(scene.start, equilibrium(game, GAME_BASIS).strategy, GAME_BASIS)
        missed = path[:, :OBSERVED] - seen
        return jnp.where(followed[:, None, None], missed, 0.0)

    start = jnp.concatenate([change, numbers], axis=1)
    prior = np.array([VELOCITY_DEVIATION] * 2 + [TRAIT_DEVIATION] * 4, np.float32)
    precision = jnp.tile(jnp.asarray(prior) ** -2.0, len(start))
    observed = 2.0 * OBSERVED * jnp.sum(followed)
    departure = jnp.zeros(start.size)
    for _ in range(LAYERS):
        # Training differentiates the step by the noise and the proposal, not by the game's second
        # derivatives.
        fixed = jax.lax.stop_gradient(start + departure.reshape(start.shape))
        error = jax.lax.stop_gradient(residual(fixed)).ravel() / noise
        slopes = jax.lax.stop_gradient(jax.jacfwd(residual)(fixed))
        slope = slopes.reshape(error.size, -1) / noise
        factor = jax.scipy.linalg.cho_factor(slope.T @ slope + jnp.diag(precision), lower=True)
        # Residuals of a linear model, at the proposal.
        linear = error - slope @ jax.lax.stop_gradient(departure)
        pull = slope.T @ linear
        departure = -jax.scipy.linalg.cho_solve(factor, pull)
    covariance = jax.scipy.linalg.cho_solve(factor, jnp.eye(start.size, dtype=error.dtype))
    determinant = 2.0 * jnp.sum(jnp.log(jnp.diag(factor[0]))) - jnp.sum(jnp.log(precision))
    evidence = -0.5 * (linear @ linear + departure @ pull + determinant)
    return Explained(
        numbers + departure.reshape(start.shape)[:, 2:],
        jnp.sqrt(jnp.diag(covariance)).reshape(start.shape)[:, 2:],
        evidence - observed * jnp.log(noise),
    )
