"""Road networks of highway-env's lanes, in its axes (y points down), metres."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.lane import CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork

CROSSING_OFFSET = 4.0
"""From an arm's axis to the middle of its lanes: a median keeps oncoming cars 8 m apart."""
CROSSING_OUTER = 14.0
"""End of the arms, where the crossing begins."""
CROSSING_ARM = 120.0
CROSSING_LIMIT = 15.0
"""m/s."""
ARMS = ("south", "west", "north", "east")
"""Clockwise as seen from above."""
HIGHWAY_LIMIT = 30.0


def crossing() -> RoadNetwork:
    """A four-arm crossing: from `<arm>_far` to `<arm>_in`, over it to `<arm>_out`, `<arm>_end`."""
    network = RoadNetwork()
    offset, outer = CROSSING_OFFSET, CROSSING_OUTER
    none, striped, solid = LineType.NONE, LineType.STRIPED, LineType.CONTINUOUS_LINE
    far = outer + CROSSING_ARM
    for k, arm in enumerate(ARMS):
        turn = k * np.pi / 2.0
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        right, ahead, left = (ARMS[(k + n) % 4] for n in (3, 2, 1))

        def straight(
            begin: tuple[float, float],
            end: tuple[float, float],
            lines: list[int],
            rotation: np.ndarray = rotation,
        ) -> StraightLane:
            ends = rotation @ np.array(begin), rotation @ np.array(end)
            return StraightLane(*ends, line_types=lines, speed_limit=CROSSING_LIMIT)

        network.add_lane(
            f"{arm}_far", f"{arm}_in", straight((offset, far), (offset, outer), [solid, solid])
        )
        network.add_lane(
            f"{arm}_out", f"{arm}_end", straight((-offset, outer), (-offset, far), [solid, solid])
        )
        network.add_lane(
            f"{arm}_in",
            f"{ahead}_out",
            straight((offset, outer), (offset, -outer), [striped, none]),
        )
        for to, side, clockwise in ((left, -1.0, False), (right, 1.0, True)):
            radius = outer - side * offset
            center = rotation @ np.array([side * outer, outer])
            phases = (0.0, -90.0) if side < 0 else (180.0, 270.0)
            begin, end = (turn + np.radians(phase) for phase in phases)
            network.add_lane(
                f"{arm}_in",
                f"{to}_out",
                CircularLane(
                    center,
                    radius,
                    begin,
                    end,
                    clockwise=clockwise,
                    line_types=[none, none],
                    speed_limit=CROSSING_LIMIT,
                ),
            )
    return network


def straight_road() -> RoadNetwork:
    """Three lanes in one direction, from "0" to "1"; lane 0 is the leftmost."""
    return RoadNetwork.straight_road_network(3, length=1000.0, speed_limit=HIGHWAY_LIMIT)


def merging_road() -> RoadNetwork:
    """`MergeEnv`'s highway of two lanes with a ramp from the right."""
    return _roads_of(MergeEnv)


def roundabout() -> RoadNetwork:
    """`RoundaboutEnv`'s roundabout of two lanes and four arms."""
    return _roads_of(RoundaboutEnv)


def _roads_of(environment: Any) -> RoadNetwork:
    """An environment's network, without making one: some write to classes when they begin."""
    stand_in = SimpleNamespace(
        np_random=np.random.RandomState(0),
        config={"show_trajectories": False, "neighbour_vehicles_connected_lanes": False},
    )
    environment._make_road(stand_in)
    network: RoadNetwork = stand_in.road.network
    return network
