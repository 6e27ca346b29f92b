"""The four scenes: roads, every car's route, and how an episode is drawn around them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from highway_env.road.road import RoadNetwork
from jaxtyping import Float

from foresight_env.highway import networks
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.routes import SPACING, LaneIndex, Leg, path_along
from foresight_env.scenarios.driving import COLLISION_DISTANCE, COLLISION_WEIGHT, player_theta
from foresight_env.scenarios.episode_parameters import EpisodeParameters

MOST_CARS = 6
LEAST_CARS = 2


class Journey(NamedTuple):
    """One car's way; distances are along its path."""

    legs: tuple[Leg, ...]
    start: float
    """m; not below 10, so that there is path behind it."""
    speed: float
    """At the start, m/s."""
    target_speed: float
    goal: float
    """m."""

    @property
    def lanes(self) -> tuple[LaneIndex, ...]:
        """The lanes in their order."""
        return tuple(leg.lane for leg in self.legs)


@dataclass(frozen=True)
class DrivingScene:
    """A road network and the journeys of up to six cars, the ego's first."""

    name: str
    roads: Callable[[], RoadNetwork]
    journeys: tuple[Journey, ...]
    max_steps: int
    center: tuple[float, float]
    """Of the picture, in our axes, m."""
    half_width: float
    collision_distance: float = COLLISION_DISTANCE
    """Between discs of two cars, below which both pay (`FootprintProximity`), m."""
    collision_weight: float = COLLISION_WEIGHT
    """Price of a squared metre below it."""

    @cached_property
    def network(self) -> RoadNetwork:
        """The roads, in highway-env's axes; nothing changes them."""
        return self.roads()

    @cached_property
    def paths(self) -> Float[np.ndarray, "cars M 4"]:
        """Every car's path, in our axes."""
        return np.stack([path_along(self.network, j.legs) for j in self.journeys])


def place_on(path: Float[np.ndarray, "M 4"], along: float) -> Float[np.ndarray, "3"]:
    """`[px, py, heading]` so far along a path, between points by interpolation."""
    at = SPACING * np.arange(len(path))
    return np.array([np.interp(along, at, path[:, k]) for k in range(3)])


def draw_driving(
    random: np.random.Generator,
    scene: DrivingScene,
    cars: int,
    ranges: DrivingRanges = DrivingRanges(),
) -> EpisodeParameters:
    """Draw initial states, target speeds and discount factors around a scene's journeys."""
    shifts = random.uniform(-ranges.along, ranges.along, cars)
    speeds = random.uniform(-ranges.speed, ranges.speed, (cars, 2))
    gamma = random.uniform(*ranges.gamma, cars)
    states, thetas = np.zeros((cars, 4)), []
    for i, journey in enumerate(scene.journeys[:cars]):
        path = scene.paths[i]
        x, y, heading = place_on(path, journey.start + shifts[i])
        states[i] = x, y, journey.speed + speeds[i, 0], heading
        thetas.append(
            player_theta(
                path.copy(),
                float(journey.target_speed + speeds[i, 1]),
                place_on(path, journey.goal)[:2],
                collision_weight=scene.collision_weight,
                collision_distance=scene.collision_distance,
            )
        )
    return EpisodeParameters(states, tuple(thetas), gamma)


def _over(begin: str, end: str, start: float) -> tuple[Leg, ...]:
    """Over the crossing from one arm to another, beginning so far along the first."""
    return (
        Leg((f"{begin}_far", f"{begin}_in", 0), start),
        Leg((f"{begin}_in", f"{end}_out", 0)),
        Leg((f"{end}_out", f"{end}_end", 0)),
    )


_ROUND = (
    ("se", "ex", 1), ("ex", "ee", 1), ("ee", "nx", 1), ("nx", "ne", 1),
    ("ne", "wx", 1), ("wx", "we", 1), ("we", "sx", 1), ("sx", "se", 1),
)  # fmt: skip
"""The outer lane of the roundabout, from the southern entry on."""
_RING_LENGTHS = np.radians(42.0) * 24.0, np.radians(48.0) * 24.0
"""Of its lanes, from an entry to the next exit and from there to the next entry, m."""


def _around(arm: str, exit: str, start: float) -> tuple[Leg, ...]:
    """Into the roundabout from one arm, to another's exit; arms are s, e, n, w.

    Entering and leaving begin before the lanes meet, so that no car has to turn sharply.
    """
    ring = list(_ROUND)
    first = next(k for k, lane in enumerate(ring) if lane[0] == f"{arm}e")
    ring = ring[first:] + ring[:first]
    last = next(k for k, lane in enumerate(ring) if lane[1] == f"{exit}x")
    on = [Leg(lane) for lane in ring[: last + 1]]
    on[0] = on[0]._replace(begin=7.0)
    on[-1] = on[-1]._replace(end=_RING_LENGTHS[last % 2] - 5.0)
    return (
        Leg((f"{arm}er", f"{arm}es", 0), start),
        Leg((f"{arm}es", f"{arm}e", 0), 0.0, 10.0),
        *on,
        Leg((f"{exit}x", f"{exit}xs", 0), 16.0),
        Leg((f"{exit}xs", f"{exit}xr", 0)),
    )


_LEFT_TURN = DrivingScene(
    "left_turn",
    networks.crossing,
    (
        Journey(_over("south", "west", 104.0), 14.0, 6.0, 9.0, 44.0),
        Journey(_over("north", "south", 80.0), 37.0, 10.0, 10.0, 90.0),
        Journey(_over("north", "west", 74.0), 14.0, 8.0, 8.0, 75.0),
        Journey(_over("south", "north", 88.0), 14.0, 6.0, 9.0, 60.0),
        Journey(_over("north", "south", 54.0), 14.0, 9.0, 10.0, 80.0),
        Journey(_over("south", "east", 72.0), 14.0, 6.0, 8.0, 60.0),
    ),
    max_steps=50,
    center=(0.0, 0.0),
    half_width=42.0,
    # So that a car that plays an equilibrium keeps the paper's 6 m between the middles of cars.
    collision_distance=8.5,
    collision_weight=10.0,
)


def _along(lane: int) -> tuple[Leg, ...]:
    """Along the highway that the ramp leads to."""
    return Leg(("a", "b", lane), 120.0), Leg(("b", "c", lane)), Leg(("c", "d", lane))


_RAMP = (
    Leg(("j", "k", 0), 120.0),
    Leg(("k", "b", 0)),
    Leg(("b", "c", 2), 0.0, 10.0),
    Leg(("b", "c", 1), 50.0),
    Leg(("c", "d", 1)),
)
_MERGE = DrivingScene(
    "merge",
    networks.merging_road,
    (
        Journey(_RAMP, 60.0, 14.0, 15.0, 150.0),
        Journey(_along(1), 55.0, 15.0, 15.0, 150.0),
        Journey(_along(1), 75.0, 14.0, 14.0, 160.0),
        Journey(_along(0), 58.0, 16.0, 17.0, 165.0),
        Journey(_along(1), 36.0, 15.0, 15.0, 150.0),
        Journey(_along(0), 36.0, 16.0, 17.0, 165.0),
    ),
    max_steps=80,
    center=(240.0, -5.0),
    half_width=70.0,
)  # fmt: skip


def _lane(number: int, start: float) -> tuple[Leg, ...]:
    return (Leg(("0", "1", number), start, start + 400.0),)


_LANE_CHANGE = DrivingScene(
    "lane_change",
    networks.straight_road,
    (
        Journey(
            (Leg(("0", "1", 1), 80.0, 112.0), Leg(("0", "1", 0), 145.0, 480.0)),
            14.0, 14.0, 16.0, 120.0,
        ),
        Journey(_lane(1, 80.0), 36.0, 9.0, 9.0, 120.0),
        Journey(_lane(0, 60.0), 14.0, 17.0, 17.0, 150.0),
        Journey(_lane(2, 80.0), 20.0, 12.0, 12.0, 120.0),
        Journey(_lane(0, 80.0), 60.0, 15.0, 15.0, 150.0),
        Journey(_lane(2, 80.0), 45.0, 11.0, 11.0, 120.0),
    ),
    max_steps=80,
    center=(150.0, -4.0),
    half_width=70.0,
)  # fmt: skip
_ROUNDABOUT = DrivingScene(
    "roundabout",
    networks.roundabout,
    (
        Journey(_around("s", "n", 105.0), 14.0, 7.0, 7.0, 110.0),
        Journey(_around("w", "e", 107.0), 44.0, 7.0, 7.0, 120.0),
        Journey(_around("w", "n", 107.0), 27.0, 7.0, 7.0, 150.0),
        Journey(_around("e", "s", 105.0), 24.0, 7.0, 7.0, 150.0),
        Journey(_around("s", "e", 88.0), 14.0, 7.0, 7.0, 90.0),
        Journey(_around("n", "s", 105.0), 14.0, 7.0, 7.0, 110.0),
    ),
    max_steps=150,
    center=(0.0, 0.0),
    half_width=60.0,
)

SCENES = {scene.name: scene for scene in (_LEFT_TURN, _MERGE, _LANE_CHANGE, _ROUNDABOUT)}
"""By name."""
