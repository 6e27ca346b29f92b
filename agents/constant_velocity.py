"""The classical ego: others keep their velocity, and the ego plans its best response to that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.motion import FIT_STEPS, extrapolate, present_state
from agents.planning import Plan, plan_response
from agents.policy import Decision
from foresight_env.envs.scene import Scene


class ConstantVelocityMemory(NamedTuple):
    """Recent observations and the last plan."""

    scene: Scene
    ego: int
    observations: tuple[Float[np.ndarray, "size"], ...]
    plan: Plan | None


@dataclass(frozen=True)
class ConstantVelocity:
    """Predict then plan, with the simplest prediction there is."""

    name: str = "constant velocity"

    def init(self, scene: Scene, agent: str | int) -> ConstantVelocityMemory:
        """See `EgoPolicy`."""
        return ConstantVelocityMemory(scene, scene.index(agent), (), None)

    def update(
        self,
        memory: ConstantVelocityMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> ConstantVelocityMemory:
        """See `EgoPolicy`."""
        seen = np.asarray(observation[:-2], dtype=float)
        return memory._replace(observations=(*memory.observations, seen)[-FIT_STEPS:])

    def act(self, memory: ConstantVelocityMemory) -> tuple[Decision, ConstantVelocityMemory]:
        """See `EgoPolicy`."""
        scene, ego = memory.scene, memory.ego
        model = scene.observation_model(ego)
        if not memory.observations:
            raise ValueError("memory: holds no observation yet; call update before act")
        seen = np.stack(memory.observations)
        players = scene.game.players
        states = [
            present_state(player.dynamics, model, seen, j, scene.dt)
            for j, player in enumerate(players)
        ]
        predicted = {
            j: extrapolate(players[j].dynamics, state, scene.game.horizon, scene.dt)
            for j, state in enumerate(states)
            if j != ego
        }
        own = scene.own(ego)
        decision, plan = plan_response(
            scene, ego, states[ego], own.theta, own.gamma, predicted, memory.plan
        )
        return decision, memory._replace(plan=plan)
