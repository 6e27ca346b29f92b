"""Behaviour cloning: an ego that does what the oracle did in what looks alike (Pomerleau, 1989).

It drives one of two pedestrians at the crosswalk, who see full states; it plans nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, PRNGKeyArray

from agents.learned.weights import FOLDER, load_network
from agents.policy import Decision
from foresight_env.envs.scene import Scene
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT

WINDOW = 4
"""Observations that it decides by: one alone is too noisy."""
SIZE = 10
"""Of an observation: two states and the own goal."""


class CloningExample(NamedTuple):
    """What was seen, and what the oracle did."""

    seen: Float32[np.ndarray, "window 10"]
    """Observations, places from where the ego is seen to be now (m)."""
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
    """Huber's: what the oracle does at its limits is not to outweigh all else."""
    error = network(example.seen) - jnp.asarray(example.control)
    size = jnp.abs(error)
    return jnp.sum(jnp.where(size < 1.0, 0.5 * error**2, size - 0.5)), jnp.ones(())


def cloning_window(observations: Float[np.ndarray, "K 10"]) -> Float32[np.ndarray, "window 10"]:
    """The last observations; of fewer than `WINDOW` the first is repeated."""
    rows = np.asarray(observations[-WINDOW:], dtype=float)
    rows = np.concatenate([np.repeat(rows[:1], WINDOW - len(rows), axis=0), rows])
    here = rows[-1, :2]
    origin = np.array([*here, 0.0, 0.0, *here, 0.0, 0.0, *here])
    return np.asarray(rows - origin, np.float32)


def cloning_examples(
    observations: Float[np.ndarray, "steps 10"], controls: Float[np.ndarray, "steps 2"]
) -> list[CloningExample]:
    """Every step of an episode."""
    return [
        CloningExample(cloning_window(observations[: k + 1]), np.asarray(control, np.float32))
        for k, control in enumerate(controls)
    ]


class CloningMemory(NamedTuple):
    """The latest observations."""

    observations: tuple[Float[np.ndarray, "10"], ...] = ()


@lru_cache(maxsize=8)
def _loaded(path: Path) -> Any:
    network, _ = load_network(path, lambda told: CloningNetwork(key=jax.random.key(0)))
    return network


@eqx.filter_jit
def _said(network: Any, seen: Any) -> Any:
    return network(seen)


@dataclass(frozen=True)
class Cloned:
    """The network as an ego."""

    name: str = "cloned"
    weights: str = ""
    """A file of `foresight train cloned`; the shipped one where empty."""

    def init(self, scene: Scene, agent: str | int) -> CloningMemory:
        """See `EgoPolicy`; `ValueError` where it has learned nothing of the scene."""
        scene.index(agent)
        crosswalk = all(name.startswith("pedestrian") for name in scene.names)
        if not (crosswalk and scene.players == 2 and scene.observation == "full"):
            raise ValueError(
                f"ego: {self.name} drives one of two pedestrians who see full states; expected the "
                f"crosswalk with players=2 and observation='full', not {', '.join(scene.names)}"
            )
        return CloningMemory()

    def update(
        self, memory: CloningMemory, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]
    ) -> CloningMemory:
        """See `EgoPolicy`."""
        seen = np.asarray(observation, dtype=float)
        return CloningMemory((*memory.observations, seen)[-WINDOW:])

    def act(self, memory: CloningMemory) -> tuple[Decision, CloningMemory]:
        """See `EgoPolicy`."""
        if not memory.observations:
            raise ValueError("memory: holds no observation yet; call update before act")
        network = _loaded(Path(self.weights) if self.weights else FOLDER / "cloned.safetensors")
        action = np.asarray(_said(network, cloning_window(np.stack(memory.observations))))
        return Decision(np.clip(action, -CONTROL_LIMIT, CONTROL_LIMIT).astype(np.float32)), memory
