"""The oracle ego: true states and all agents' true parameters; no competitor.

It does not know which of several equilibria the others play, so it is no upper bound either.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.planning import Plan, plan_equilibrium
from agents.interfaces.policy import Decision
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.envs.core.world import unstacked


class OracleMemory(NamedTuple):
    """Latest ground truth."""

    scene: Scene
    ego: int
    info: Mapping[str, Any]
    plan: Plan | None


@dataclass(frozen=True)
class Oracle:
    """Plays the equilibrium of the true game."""

    name: str = "oracle"

    def init(self, scene: Scene, agent: str | int) -> OracleMemory:
        """See `EgoPolicy`."""
        return OracleMemory(scene, scene.index(agent), {}, None)

    @no_type_check
    def update(
        self, memory: OracleMemory, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]
    ) -> OracleMemory:
        """See `EgoPolicy`."""
        check_memory(memory, OracleMemory)
        memory.scene.check_episode(memory.ego, observation, info)
        return memory._replace(info=info)

    @no_type_check
    def act(self, memory: OracleMemory) -> tuple[Decision, OracleMemory]:
        """See `EgoPolicy`."""
        check_memory(memory, OracleMemory)
        info, scene = memory.info, memory.scene
        for name in ("state", "gamma", "theta"):
            if info.get(name) is None:
                raise ValueError(
                    f"memory: holds no information {name!r}; call update before act, with the "
                    "environment's info"
                )
        theta = [unstacked(info["theta"], j) for j in range(scene.players)]
        gammas = {j: (float(g), 0.0) for j, g in enumerate(info["gamma"]) if j != memory.ego}
        decision, plan = plan_equilibrium(
            scene, memory.ego, list(info["state"]), theta, info["gamma"], memory.plan, gammas
        )
        return decision, memory._replace(plan=plan)
