"""The classical ego: others keep their velocity, and the ego plans its best response to that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.motion import extrapolate
from agents.perception import Perception
from agents.planning import Plan, plan_response
from agents.policy import Decision
from foresight_env.envs.scene import Scene


class ConstantVelocityMemory(NamedTuple):
    """What was seen, and the last plan."""

    perception: Perception
    plan: Plan | None = None


@dataclass(frozen=True)
class ConstantVelocity:
    """Predict then plan, with the simplest prediction there is."""

    name: str = "constant velocity"

    def init(self, scene: Scene, agent: str | int) -> ConstantVelocityMemory:
        """See `EgoPolicy`."""
        return ConstantVelocityMemory(Perception(scene, scene.index(agent)))

    def update(
        self,
        memory: ConstantVelocityMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> ConstantVelocityMemory:
        """See `EgoPolicy`."""
        return memory._replace(perception=memory.perception.taking(observation))

    def act(self, memory: ConstantVelocityMemory) -> tuple[Decision, ConstantVelocityMemory]:
        """See `EgoPolicy`."""
        scene, ego = memory.perception.scene, memory.perception.ego
        players, states = scene.game.players, memory.perception.states()
        predicted = {
            j: extrapolate(players[j].dynamics, state, scene.game.horizon, scene.dt)
            for j, state in enumerate(states)
            if j != ego
        }
        own = scene.own(ego)
        decision, plan = plan_response(
            scene, ego, states[ego], own.theta, own.gamma, predicted, memory.plan
        )
        return decision, ConstantVelocityMemory(memory.perception.acted(decision.action), plan)
