"""Estimate of the ego's own state from its actions and noisy observations.

An extended Kalman filter with the game's own dynamics. The equilibrium that an estimator fits is a
worse estimate: noise makes the ego leave the equilibrium, and its plan must begin where it is.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from foresight_env.envs.core.scene import Scene
from foresight_env.games import Dynamics, ObservationModel, Vehicle
from foresight_env.games.motion import moving_state
from foresight_env.inverse.kalman import kalman_update
from foresight_env.precision import in_double_precision

LEAST_VARIANCE = 1e-6
"""Variance (m^2) that noise-free observations are given: equilibria are not exact models."""
PROCESS = 1e-3
"""Variance that a step adds, as a part of the noise's: actions are rounded to single precision and
reduced at limits, else the motion is known exactly. The filter remembers some 30 steps."""
UNSEEN = 1.0
"""Largest variance (rad^2) of a heading that is known from two positions only."""


def observation_variance(scene: Scene) -> float:
    """Variance of every observed coordinate, for estimators."""
    return max(scene.noise_std**2, LEAST_VARIANCE)


class OwnState(NamedTuple):
    """Gaussian estimate of the ego's own state."""

    mean: Float[np.ndarray, "n"] | None = None
    """None before enough was seen."""
    covariance: Float[np.ndarray, "n n"] = np.zeros((0, 0))
    action: Float[np.ndarray, "m"] | None = None
    """Since the last observation."""
    seen: Float[np.ndarray, "k"] | None = None
    """The last own observation, while there is no mean."""

    def acted(self, action: Float[np.ndarray, "m"]) -> OwnState:
        """Return the same with the present action."""
        return self._replace(action=np.asarray(action, dtype=float))


@in_double_precision
@partial(jax.jit, static_argnums=0)
def _moved(
    dynamics: Dynamics, state: Float[Array, "n"], control: Float[Array, "m"]
) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """The next state, and its derivative by the state."""
    # Dynamics of agents do not depend on the stage.
    return dynamics(1, state, control), jax.jacfwd(dynamics, argnums=1)(1, state, control)


def follow_own_state(
    scene: Scene,
    ego: int,
    model: ObservationModel,
    own: OwnState,
    observation: Float[np.ndarray, "size"],
) -> OwnState:
    """Move on by the action that was taken and take in an observation (NaN where missing).

    Own entries of an observation are the leading entries of the state, positions at least.
    """
    player = scene.game.players[ego]
    seen = observation[[k for k, owner in enumerate(model.owners) if owner == ego]]
    variance = observation_variance(scene)
    if own.mean is None or own.action is None:
        return _begin(player.dynamics, own, seen, variance, scene.dt)
    mean, rates = _moved(player.dynamics, own.mean, own.action)
    covariance = rates @ own.covariance @ rates.T + PROCESS * variance * np.eye(len(mean))
    there = np.flatnonzero(~np.isnan(seen))
    mean, covariance = kalman_update(
        mean,
        covariance,
        np.eye(len(mean))[there],
        seen[there] - mean[there],
        variance * np.eye(len(there)),
    )
    if player.state_bounds is not None:
        mean = np.clip(mean, player.state_bounds.lower[0], player.state_bounds.upper[0])
    return OwnState(mean, covariance)


def _begin(
    dynamics: Dynamics, own: OwnState, seen: np.ndarray, variance: float, dt: float
) -> OwnState:
    """From a whole state at once, from positions when there are two in succession."""
    if np.isnan(seen).any():
        return OwnState()
    if len(seen) == dynamics.state_size:
        return OwnState(seen.copy(), variance * np.eye(len(seen)))
    if own.seen is None:
        return OwnState(seen=seen)
    velocity = (seen[:2] - own.seen[:2]) / dt
    doubt = 2.0 * variance / dt**2
    spread = np.array([variance, variance, doubt, doubt])
    if isinstance(dynamics, Vehicle):
        spread[3] = min(doubt / max(float(velocity @ velocity), 1e-12), UNSEEN)
    return OwnState(moving_state(dynamics, seen[:2], velocity), np.diag(spread))
