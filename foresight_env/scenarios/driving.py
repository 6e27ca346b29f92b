"""Cars on a road network: each follows its path at its speed and makes way (paper, section VI-C).

The vehicle is highway-env's. A car's path, speed and weights are in `theta`, so that one game
serves every road. Units: metres, seconds, radians; y points up, cars drive on the right.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from foresight_env.games.constraints import Bounds, Inequality
from foresight_env.games.costs import TargetSpeed
from foresight_env.games.dynamics import SlipBicycle
from foresight_env.games.game import Game, Player
from foresight_env.games.kinds import SIMULATED_CAR
from foresight_env.games.paths import FootprintProximity, LaneBounds, PathFollowing
from foresight_env.games.steering import Steering

DT = 0.1
SUBSTEPS = 2
HORIZON = 11
"""The paper's planning horizon."""
ACCELERATION_LIMIT = 5.0
"""m/s^2, to both sides: highway-env's continuous actions."""
STEERING_LIMIT = 0.6
"""rad. highway-env allows pi/4; cars do not turn as sharply at speed."""
SPEED_LIMIT = SIMULATED_CAR.speed_limit
"""m/s; cars do not reverse."""

LANE_HALF_WIDTH = 1.0
"""How far off its path a car's middle may be, m: half a lane less half a car."""
LANE_PENALTY = 50.0
"""Per metre beyond and stage: cars that a user drives may leave their lane, and the others' game
must have a solution all the same."""

PATH_WEIGHT = 2.0
SPEED_WEIGHT = 0.2
CONTROL_WEIGHT = 0.1
STEERING_WEIGHT = 2.0
COLLISION_WEIGHT = 3.0
COLLISION_DISTANCE = 3.9
"""Between centres of the discs that cover two cars, m: just less than between lanes."""


def player_theta(
    path: Any,
    target_speed: float,
    goal: Any,
    *,
    path_weight: float = PATH_WEIGHT,
    speed_weight: float = SPEED_WEIGHT,
    collision_weight: float = COLLISION_WEIGHT,
    collision_distance: float = COLLISION_DISTANCE,
) -> dict[str, Any]:
    """One car's parameters.

    `path` (M, 4): points `[px, py, heading, curvature]`; `target_speed`: m/s; `goal` (2,): the
    place on the path where the journey ends, which costs nothing.
    """
    return {
        "path": path,
        "goal": goal,
        "target_speed": target_speed,
        "path_weight": path_weight,
        "speed_weight": speed_weight,
        "control_weight": CONTROL_WEIGHT,
        "steering_weight": STEERING_WEIGHT,
        "collision_weight": collision_weight,
        "collision_distance": collision_distance,
    }


@lru_cache(maxsize=64)
def driving_game(
    cars: int, horizon: int = HORIZON, dt: float = DT, substeps: int = SUBSTEPS
) -> Game:
    """The game between so many cars; `theta` as `player_theta` makes it."""
    if cars < 1:
        raise ValueError(f"cars: is {cars}; expected at least 1")
    limits = ACCELERATION_LIMIT, STEERING_LIMIT
    infinite = float("inf")
    car = Player(
        SlipBicycle(dt, substeps, SIMULATED_CAR.length),
        (
            PathFollowing("path_weight"),
            TargetSpeed("target_speed", "speed_weight"),
            Steering("control_weight", "steering_weight"),
            *((FootprintProximity("collision_distance", "collision_weight"),) if cars > 1 else ()),
        ),
        inequalities=(Inequality(LaneBounds(LANE_HALF_WIDTH), 2, LANE_PENALTY),),
        state_bounds=Bounds.box(
            (-infinite, -infinite, 0.0, -infinite), (infinite, infinite, SPEED_LIMIT, infinite), 4
        ),
        control_bounds=Bounds.box([-limit for limit in limits], limits, 2),
        # The journey's end costs nothing, and a single car meets no other.
        extra_theta=("goal", "collision_weight", "collision_distance"),
    )
    return Game((car,) * cars, horizon, (), dt)
