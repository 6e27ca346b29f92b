"""Reactive egos: networks that control one of two pedestrians at the crosswalk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.perception import Perception
from agents.interfaces.policy import Decision
from agents.learned.cloning import CloningNetwork
from agents.learned.crosswalk_window import WINDOW, crosswalk_window
from agents.learned.policy_network import PolicyNetwork
from agents.learned.weights import FOLDER, load_network
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT

REACTIVE: dict[str, Any] = {"cloned": CloningNetwork, "ppo": PolicyNetwork}
"""Networks by the name of their ego."""


class ReactiveMemory(NamedTuple):
    """Latest observations and present states."""

    perception: Perception
    observations: tuple[Float[np.ndarray, "10"], ...] = ()


@lru_cache(maxsize=8)
def _loaded(path: Path) -> Any:
    def make(description: dict[str, Any]) -> Any:
        return REACTIVE[description["network"]](key=jax.random.key(0))

    return load_network(path, make)[0]


@eqx.filter_jit
def _said(network: Any, seen: Any) -> Any:
    return network(seen)


@dataclass(frozen=True)
class ReactiveEgo:
    """A network of this library, with shipped or custom weights."""

    name: str
    """One of `REACTIVE`."""
    weights: str = ""
    """A .safetensors file that `foresight train` has written; empty: the shipped one."""

    def init(self, scene: Scene, agent: str | int) -> ReactiveMemory:
        """See `EgoPolicy`; `ValueError` for scenes that it was not trained on."""
        ego = scene.index(agent)
        crosswalk = all(name.startswith("pedestrian") for name in scene.names)
        if not (crosswalk and scene.players == 2 and scene.observation == "full"):
            raise ValueError(
                f"ego: {self.name} drives one of two pedestrians who see full states; expected the "
                f"crosswalk with players=2 and observation='full', not {', '.join(scene.names)}"
            )
        return ReactiveMemory(Perception(scene, ego))

    @no_type_check
    def update(
        self,
        memory: ReactiveMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> ReactiveMemory:
        """See `EgoPolicy`."""
        check_memory(memory, ReactiveMemory)
        memory.perception.scene.check_episode(memory.perception.ego, observation, info)
        perception = memory.perception.taking(observation, info)
        if perception.missing:
            return memory._replace(perception=perception)
        own, other = perception.states()[perception.ego], perception.states()[1 - perception.ego]
        moved = np.concatenate([own, other, observation[-2:]])
        seen = np.where(np.isnan(observation), moved, observation)
        return ReactiveMemory(perception, (*memory.observations, seen)[-WINDOW:])

    @no_type_check
    def act(self, memory: ReactiveMemory) -> tuple[Decision, ReactiveMemory]:
        """See `EgoPolicy`."""
        check_memory(memory, ReactiveMemory)
        if memory.perception.missing:
            decision, perception = memory.perception.waiting()
            return decision, memory._replace(perception=perception)
        path = Path(self.weights) if self.weights else FOLDER / f"{self.name}.safetensors"
        seen = crosswalk_window(np.stack(memory.observations))
        action = np.clip(np.asarray(_said(_loaded(path), seen)), -CONTROL_LIMIT, CONTROL_LIMIT)
        perception = memory.perception.acted(action)
        return Decision(action.astype(np.float32)), memory._replace(perception=perception)
