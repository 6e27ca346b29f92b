"""The oracle ego: true states, all agents' true parameters, and the others' own equilibrium.

It plays its part of the plan that the others follow (`plan_states`, `plan_controls` in the
environment's information), so both expect the same agent to give way. Where the others make no
joint plan, as highway-env's vehicles, it plays an equilibrium of the true game.

No competitor: it sees what other egos have to infer. It is no upper bound of what can be achieved
either, since a best response to the others' policy may do better than the equilibrium
(`evaluation.rollout.clairvoyant`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.planning import Plan, plan_equilibrium, within_limits
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
    """Plays the equilibrium of the true game that the others play."""

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
        gammas = {j: (float(g), 0.0) for j, g in enumerate(info["gamma"]) if j != memory.ego}
        shared = _shared_plan(scene, memory.ego, info, gammas)
        if shared is not None:
            return shared, memory._replace(plan=None)
        theta = [unstacked(info["theta"], j) for j in range(scene.players)]
        decision, plan = plan_equilibrium(
            scene, memory.ego, list(info["state"]), theta, info["gamma"], memory.plan, gammas
        )
        return decision, memory._replace(plan=plan)


def _shared_plan(
    scene: Scene, ego: int, info: Mapping[str, Any], gammas: dict[int, tuple[float, float]]
) -> Decision | None:
    """Return the ego's part of the plan that the others follow; None where they have no plan."""
    stages = info.get("plan_stages", 0)
    if not stages:
        return None
    states, controls = info["plan_states"], info["plan_controls"]
    action = within_limits(scene.game, ego, controls[ego, 0]).astype(np.float32)
    paths = states[:, 1 : stages + 1, :2]
    predicted = {j: paths[j] for j in range(scene.players) if j != ego}
    fallback = not info.get("plan_solved", True)
    return Decision(action, paths[ego], predicted, gammas, plan_fallback=fallback)
