"""Traffic at the published intersection, drawn at random: up to four people and four cars.

The first two of each are the paper's; two people come the other way over the western arm, a car
comes from the south and one from the west. Positions, corners and road sides are those of `AACHEN`;
cars are as long as cars, drive on through the junction, and keep a distance that fits their size.
Units: metres, seconds, radians.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.games.game import Game
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.roads import Lane
from foresight_env.scenarios.aachen import (
    AACHEN,
    AACHEN_FOLLOWING,
    AACHEN_REGION,
    AACHEN_TURNING,
)
from foresight_env.scenarios.episode_parameters import EpisodeParameters
from foresight_env.scenarios.intersection import (
    DT,
    Region,
    intersection_game,
    player_theta,
)
from foresight_env.scenarios.ranges import check_ranges

MOST = 4
"""Of pedestrians and of cars."""
HORIZON = 15
WHEELBASE = 2.7
"""Of a car of today, m; the paper's 1 m turns on the spot."""
PENALTY = 100.0
"""Per metre off the road and stage: agents that a user controls may leave it, and the others'
game must have a solution all the same."""
JUNCTION_REGION = Region(AACHEN_REGION.corners, AACHEN_REGION.sides)
"""Without the published box, which is the recording's view: cars drive on."""

PEDESTRIAN_WEIGHT = 1.0
"""Of pedestrians' goals."""
CAR_WEIGHT = 0.03
"""Of cars' goals, which are far ahead: cars keep to 4 to 9 m/s."""
LANE_WEIGHT = 2.0
COLLISION_WEIGHT = 50.0
PEDESTRIAN_DISTANCE, CAR_DISTANCE = 3.0, 4.0
"""Distances from centre to centre below which there is a collision cost, for both kinds, m."""

_WEST = Lane.fit(np.array([(-34.0, 60.9), (9.0, 60.9)]), 1)
_SOUTH = Lane.fit(np.array([(-14.4, 30.0), (-6.5, 95.4)]), 1)
LANES = (AACHEN_TURNING, AACHEN_FOLLOWING, _SOUTH, _WEST)
"""Of the cars in their order: into the western arm, straight on from the north, from the south, and
from the west."""

_PEDESTRIANS = np.concatenate(
    [AACHEN.initial_state[:2], [(-17.5, 75.0, -0.3, -1.3), (-20.5, 56.5, 0.2, 1.3)]]
)
_PEDESTRIAN_GOALS = np.array([(-18.3, 78.5), (-17.3, 79.0), (-20.5, 55.5), (-18.0, 76.0)])
"""On the pavements: who stopped on the road would be in the way of the cars that follow."""
_CARS = np.concatenate(
    [AACHEN.initial_state[2:], [(-12.1, 49.0, 6.0, _SOUTH.angle), (-31.0, 60.9, 5.0, 0.0)]]
)
_CAR_GOALS = np.array([(-33.0, 63.9), (-17.3, 43.0), (-7.4, 88.0), (3.0, 60.9)])


BEFORE = 20.0
"""Length of a car's route before its nominal start, m."""


def junction_routes(cars: int) -> tuple[Float[np.ndarray, "_ 4"], ...]:
    """Centre lines of the cars' routes up to their goals.

    Points `[px, py, heading, curvature]`, 1 m apart (m, rad, 1/m).
    """
    found = []
    for lane, car, goal in zip(LANES[:cars], _CARS, _CAR_GOALS, strict=False):
        begin = car[:2] - BEFORE * np.array([np.cos(car[3]), np.sin(car[3])])
        found.append(lane.centre_line((begin[0], begin[1]), (goal[0], goal[1])))
    return tuple(found)


def junction_kinds(pedestrians: int, cars: int) -> tuple[str, ...]:
    """Kinds of all players, pedestrians first; `ValueError` beyond 1 to 4 of each."""
    for name, count in (("pedestrians", pedestrians), ("cars", cars)):
        if not 1 <= count <= MOST:
            raise ValueError(f"{name}: is {count}; a junction has 1 to {MOST}")
    return ("pedestrian",) * pedestrians + ("car",) * cars


def junction_game(pedestrians: int = 2, cars: int = 2, horizon: int = HORIZON) -> Game:
    """The game at the junction; `theta` is as `intersection.player_theta` makes it."""
    kinds = junction_kinds(pedestrians, cars)
    lanes = (None,) * pedestrians + LANES[:cars]
    return intersection_game(kinds, lanes, JUNCTION_REGION, horizon, DT, WHEELBASE, PENALTY)


LARGEST_SHIFTS = {"along": 3.0, "place": 1.0, "speed": 4.0, "goal": 10.0}
"""Of `JunctionRanges`, m and m/s: agents are not drawn on top of each other or off the road."""


class JunctionRanges(NamedTuple):
    """From which ranges an episode's hidden parameters are drawn, uniformly."""

    gamma: tuple[float, float] = (0.3, 1.0)
    along: float = 2.0
    """Largest shift of a car's start along its heading, m."""
    place: float = 0.5
    """Largest shift of each coordinate of a pedestrian's start, m."""
    speed: float = 1.0
    """Largest difference of a car's speed from its nominal one, m/s."""
    goal: float = 0.5
    """Largest shift of each goal coordinate, m."""
    collision_weight: tuple[float, float] = (COLLISION_WEIGHT, COLLISION_WEIGHT)

    def check(self) -> None:
        """Raise `ValueError` where a draw might be no legal episode."""
        check_ranges(self, ("gamma", "collision_weight"), LARGEST_SHIFTS)


def draw_junction(
    random: np.random.Generator,
    pedestrians: int = 2,
    cars: int = 2,
    ranges: JunctionRanges = JunctionRanges(),
) -> EpisodeParameters:
    """Draw initial states, goals, weights and discount factors around the published ones."""
    kinds = junction_kinds(pedestrians, cars)
    people, vehicles = _PEDESTRIANS[:pedestrians].copy(), _CARS[:cars].copy()
    people[:, :2] += random.uniform(-ranges.place, ranges.place, (pedestrians, 2))
    heading = np.stack([np.cos(vehicles[:, 3]), np.sin(vehicles[:, 3])], axis=1)
    vehicles[:, :2] += random.uniform(-ranges.along, ranges.along, (cars, 1)) * heading
    vehicles[:, 2] += random.uniform(-ranges.speed, ranges.speed, cars)
    goals = np.concatenate([_PEDESTRIAN_GOALS[:pedestrians], _CAR_GOALS[:cars]])
    goals += random.uniform(-ranges.goal, ranges.goal, goals.shape)
    gamma = random.uniform(*ranges.gamma, len(kinds))
    weights = random.uniform(*ranges.collision_weight, len(kinds))
    theta = tuple(
        player_theta(
            kind,
            goal,
            goal_weight=CAR_WEIGHT if is_vehicle(kind) else PEDESTRIAN_WEIGHT,
            collision_weight=float(weight),
            collision_distance=CAR_DISTANCE if is_vehicle(kind) else PEDESTRIAN_DISTANCE,
            lane_weight=LANE_WEIGHT,
        )
        for kind, goal, weight in zip(kinds, goals, weights, strict=True)
    )
    return EpisodeParameters(np.concatenate([people, vehicles]), theta, gamma)
