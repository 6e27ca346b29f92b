"""The traffic-engineering ego: highway-env's IDM vehicle on the ego's own path.

It keeps its distance from the agent ahead on that path and sees no crossing traffic (Treiber,
Hennecke and Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Physical Review E 62, 2000). It steers as highway-env's `ControlledVehicle` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import PolyLaneFixedWidth
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.perception import Perception
from agents.interfaces.policy import Decision
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.highway.axes import flipped_controls, flipped_places, flipped_states

LANE = ("begin", "end", 0)
"""The one lane of the road that the ego sees: its path."""


class IdmMemory(NamedTuple):
    """Observations, and the path as a road."""

    perception: Perception
    network: RoadNetwork


@dataclass(frozen=True)
class Idm:
    """Follows its path at its speed, behind the agent ahead on it."""

    name: str = "idm"

    def init(self, scene: Scene, agent: str | int) -> IdmMemory:
        """See `EgoPolicy`; `ValueError` where the agent has no path to follow."""
        ego = scene.index(agent)
        own = scene.own(ego).theta
        if "path" not in own:
            raise ValueError(
                f"scene: {scene.names[ego]} follows no path; the IDM ego drives cars of the "
                "scenario driving"
            )
        network = RoadNetwork()
        places = flipped_places(np.asarray(own["path"])[:, :2])
        network.add_lane(*LANE[:2], PolyLaneFixedWidth([tuple(p) for p in places.tolist()]))
        return IdmMemory(Perception(scene, ego), network)

    @no_type_check
    def update(
        self, memory: IdmMemory, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]
    ) -> IdmMemory:
        """See `EgoPolicy`."""
        check_memory(memory, IdmMemory)
        perception = memory.perception
        perception.scene.check_episode(perception.ego, observation, info)
        return memory._replace(perception=perception.taking(observation, info))

    @no_type_check
    def act(self, memory: IdmMemory) -> tuple[Decision, IdmMemory]:
        """See `EgoPolicy`."""
        check_memory(memory, IdmMemory)
        scene, ego = memory.perception.scene, memory.perception.ego
        if memory.perception.missing:
            decision, perception = memory.perception.waiting()
            return decision, memory._replace(perception=perception)
        states = flipped_states(np.stack(memory.perception.states()))
        road = Road(memory.network, [], np_random=np.random.RandomState(0))
        own = IDMVehicle(
            road,
            states[ego, :2],
            float(states[ego, 3]),
            float(states[ego, 2]),
            target_lane_index=LANE,
            target_speed=float(scene.own(ego).theta["target_speed"]),
            enable_lane_change=False,
        )
        others = [
            Vehicle(road, state[:2], float(state[3]), float(state[2]))
            for j, state in enumerate(states)
            if j != ego
        ]
        road.vehicles = [own, *others]
        own.act()
        control = np.array([own.action["acceleration"], own.action["steering"]])
        action = flipped_controls(control[None])[0]
        box = scene.game.players[ego].control_bounds
        if box is not None:
            action = np.clip(action, box.lower[0], box.upper[0])
        perception = memory.perception.acted(action)
        return Decision(action.astype(np.float32)), memory._replace(perception=perception)
