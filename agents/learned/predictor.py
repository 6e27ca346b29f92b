"""A trained network as a predictor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from agents.learned.features import AGENTS, AHEAD, STEP, Frames, features_of, straight
from agents.learned.head import Futures
from agents.learned.interaction_transformer import InteractionTransformer
from agents.learned.social_lstm import SocialLstm
from agents.learned.weights import FOLDER, load_network
from agents.predictors.kinematic import ConstantVelocityPredictor

NETWORKS: dict[str, Any] = {"social-lstm": SocialLstm, "transformer": InteractionTransformer}
"""Forecasters by name."""


@lru_cache(maxsize=8)
def _loaded(path: Path) -> tuple[Any, float]:
    def make(description: dict[str, Any]) -> Any:
        return NETWORKS[description["network"]](key=jax.random.key(0))

    network, description = load_network(path, make)
    return network, float(description["calibration"])


@eqx.filter_jit
def futures_of(network: Any, seen: Any) -> Futures:
    """Output of a network; one compiled program for all histories."""
    found: Futures = network(seen)
    return found


@dataclass(frozen=True)
class LearnedPredictor:
    """A network of this library, with shipped or custom weights."""

    name: str
    """One of `NETWORKS`."""
    weights: str = ""
    """A .safetensors file that `foresight train` has written; empty: the shipped one."""

    def predict(self, history: History, steps: int) -> Forecast:
        """K joint futures; beyond 4 s they continue their last motion.

        Of more than `AGENTS` agents those beyond go straight on.
        """
        path = Path(self.weights) if self.weights else FOLDER / f"{self.name}.safetensors"
        network, calibration = _loaded(path)
        seen, frames = features_of(history)
        found = jax.tree.map(np.asarray, futures_of(network, seen))
        count = len(frames.place)
        times = history.dt * np.arange(1, steps + 1)
        away, spread = (
            resampled(np.asarray(values, dtype=float)[:, :count], times)
            for values in (found.departure, found.deviation)
        )
        logits = np.asarray(found.logits, dtype=float)
        probabilities = np.exp(logits - logits.max())
        positions, covariance = in_plane(frames, times, away, calibration * spread)
        if len(history.kinds) > AGENTS:
            return _with_rest(history, steps, positions, probabilities, covariance)
        return Forecast(positions, probabilities / probabilities.sum(), covariance)


def resampled(
    values: Float[np.ndarray, "K A ahead 2"], times: Float[np.ndarray, "P"]
) -> Float[np.ndarray, "K A P 2"]:
    """At other times (s): between steps by interpolation from 0 on, beyond the last in its line."""
    knots = STEP * np.arange(AHEAD + 1)
    whole = np.concatenate([np.zeros_like(values[:, :, :1]), values], axis=2)
    place = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, AHEAD - 1)
    part = ((times - knots[place]) / STEP)[:, None]
    return np.asarray((1.0 - part) * whole[:, :, place] + part * whole[:, :, place + 1])


def in_plane(
    frames: Frames,
    times: Float[np.ndarray, "P"],
    away: Float[np.ndarray, "K A P 2"],
    spread: Float[np.ndarray, "K A P 2"],
) -> tuple[Float[np.ndarray, "K P A 2"], Float[np.ndarray, "K P A 2 2"]]:
    """Positions (m) and covariances (m^2) in the axes of the history."""
    turned = np.einsum("kapj,aij->kpai", away, frames.rotation)
    covariance = np.einsum("aij,kapj,alj->kpail", frames.rotation, spread**2, frames.rotation)
    return straight(frames, times) + turned, covariance


def _with_rest(
    history: History,
    steps: int,
    positions: Float[np.ndarray, "K P A 2"],
    probabilities: Float[np.ndarray, "K"],
    covariance: Float[np.ndarray, "K P A 2 2"],
) -> Forecast:
    """Agents beyond the network's places: straight motion with the largest deviation within."""
    line = ConstantVelocityPredictor().predict(history, steps).most_likely[:, AGENTS:]
    rest = np.broadcast_to(line, (len(positions), *line.shape))
    most = covariance.max(axis=2, keepdims=True)
    wide = np.broadcast_to(
        most.max(axis=(3, 4), keepdims=True) * np.eye(2), (*most.shape[:2], 1, 2, 2)
    )
    return Forecast(
        np.concatenate([positions, rest], axis=2),
        probabilities / probabilities.sum(),
        np.concatenate([covariance, np.repeat(wide, line.shape[1], axis=2)], axis=2),
    )
