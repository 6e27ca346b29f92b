"""An intersection: cars on their lanes, pedestrians who cross (paper, section VI-B).

Cars are kinematic bicycles that pay for distance to their lane's centre; pedestrians are double
integrators. Corners, road sides and the edge of the region are constraints. Units: metres, seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from foresight_env.games.constraints import Bounds, Inequality
from foresight_env.games.costs import Effort, Goal, SigmoidProximity
from foresight_env.games.dynamics import DoubleIntegrator, KinematicBicycle
from foresight_env.games.game import Game, Player
from foresight_env.games.kinds import is_vehicle, kind_of
from foresight_env.games.roads import (
    Circle,
    Lane,
    LaneCenter,
    OutsideCircles,
    Point,
    RoadBoundary,
    RoadSide,
)

DT = 0.24
"""Every sixth frame of a recording at 25 Hz."""
HORIZON = 28
WHEELBASE = 1.0
"""The paper's `l`, m: shorter than a car's, which would turn less for the same steering angle."""
ACCELERATION_LIMIT = 5.0
"""Of cars, m/s^2."""
STEERING_LIMIT = np.pi / 4
WALKING_ACCELERATION_LIMIT = 5.0
"""Per axis, m/s^2."""
PEDESTRIAN_SHRINK = 0.3
"""Pedestrians stay outside this part of a corner's radius: they walk on its pavement."""
SHARPNESS = 10.0
"""Of the collision cost's sigmoid, 1/m."""
COLLISION_DISTANCE = 1.0
LANE_WEIGHT = 10.0
WEIGHT = 1.0
"""Of goal, control and collision, where the reference starts."""


@dataclass(frozen=True)
class Region:
    """Region of the agents: outside corners, within road sides, inside a box."""

    corners: tuple[Circle, ...] = ()
    sides: tuple[RoadSide, ...] = ()
    low: Point = (-np.inf, -np.inf)
    high: Point = (np.inf, np.inf)


class Violation(NamedTuple):
    """A part of a region that an agent was observed in."""

    part: str
    """`"corner"` or `"side"`."""
    number: int
    """Of the part in its `Region`."""
    depth: float
    """How far inside the agent was, m."""


def violations(
    kind: str, region: Region, places: Float[np.ndarray, "K 2"]
) -> tuple[Violation, ...]:
    """Return the corners and road sides that an agent's observed places contradict.

    Args:
        kind: Of the agent; corners are smaller for those who walk, who have no road sides.
        region: What is forbidden.
        places: Where it was observed, m; NaN where it was not.

    Returns:
        One entry per corner and side; empty for an agent that was never observed.
    """
    seen = places[~np.isnan(places).any(axis=1)]
    if not len(seen):
        return ()
    walks = not is_vehicle(kind)
    found = []
    for index, corner in enumerate(region.corners):
        radius = corner.radius * (PEDESTRIAN_SHRINK if walks else 1.0)
        depth = radius - np.min(np.hypot(*(seen - corner.center).T), initial=np.inf)
        if depth > 0.0:
            found.append(Violation("corner", index, float(depth)))
    if not walks and region.sides:
        boundary = RoadBoundary(region.sides)
        inside = np.array([boundary(0, 1, (jnp.asarray(place),), (), {}) for place in seen])
        for index, depth in enumerate(-inside.min(axis=0, initial=np.inf)):
            if depth > 0.0:
                found.append(Violation("side", index, float(depth)))
    return tuple(found)


def without_violated(region: Region, found: Sequence[Violation]) -> Region:
    """Return a region without the parts that an agent was observed in."""
    out = {(violation.part, violation.number) for violation in found}
    return replace(
        region,
        corners=tuple(c for k, c in enumerate(region.corners) if ("corner", k) not in out),
        sides=tuple(s for k, s in enumerate(region.sides) if ("side", k) not in out),
    )


def player_theta(
    kind: str,
    goal: Any,
    *,
    goal_weight: float = WEIGHT,
    control_weight: float = WEIGHT,
    collision_weight: float = WEIGHT,
    collision_distance: float = COLLISION_DISTANCE,
    lane_weight: float = LANE_WEIGHT,
) -> dict[str, Any]:
    """One player's parameters: goal (2,) in metres, a distance, and weights of its costs.

    Only cars have a `lane_weight`.
    """
    theta = {
        "goal": goal,
        "goal_weight": goal_weight,
        "control_weight": control_weight,
        "collision_weight": collision_weight,
        "collision_distance": collision_distance,
    }
    return theta if not is_vehicle(kind) else {**theta, "lane_weight": lane_weight}


@lru_cache(maxsize=64)
def intersection_game(
    kinds: tuple[str, ...],
    lanes: tuple[Lane | None, ...],
    region: Region | tuple[Region, ...] = Region(),
    horizon: int = HORIZON,
    dt: float = DT,
    wheelbase: float = WHEELBASE,
    penalty: float | None = None,
) -> Game:
    """The game between agents of these kinds; `theta` of each player is as `player_theta` makes it.

    Args:
        kinds: per agent, "pedestrian" or a vehicle's kind.
        lanes: per agent, a car's lane; None for pedestrians and for cars without one.
        region: what is forbidden, for all agents or one per agent.
        horizon: stages.
        dt: s per stage.
        wheelbase: of cars, m.
        penalty: None makes the region's constraints hard; a number makes them elastic, for states
            that are only estimated and may lie outside.
    """
    if not kinds:
        raise ValueError("kinds: is empty; expected one kind per agent")
    if len(lanes) != len(kinds):
        raise ValueError(f"lanes: has {len(lanes)} entries; expected one per agent, {len(kinds)}")
    for i, (kind, lane) in enumerate(zip(kinds, lanes, strict=True)):
        if not is_vehicle(kind) and lane is not None:
            raise ValueError(f"lanes[{i}]: agent {i} is a {kind}; only vehicles have a lane")
    regions = (region,) * len(kinds) if isinstance(region, Region) else region
    if len(regions) != len(kinds):
        raise ValueError(f"region: has {len(regions)} entries; expected one, or one per agent")
    cars = tuple(i for i, kind in enumerate(kinds) if is_vehicle(kind))
    players = []
    for kind, lane, allowed in zip(kinds, lanes, regions, strict=True):
        walks = not is_vehicle(kind)
        near = SigmoidProximity(
            "collision_distance", "collision_weight", SHARPNESS, cars if walks else None
        )
        costs: tuple[Any, ...] = (Goal("goal_weight"), Effort("control_weight"), near)
        if lane is not None:
            costs = (*costs, LaneCenter(lane, "lane_weight"))
        players.append(
            Player(
                DoubleIntegrator(dt) if walks else KinematicBicycle(dt, wheelbase),
                costs,
                state_bounds=_state_bounds(kind, allowed),
                control_bounds=_control_bounds(walks),
                inequalities=_region_constraints(walks, allowed, penalty),
                name=kind,
                # Of cars without a lane, and of people whose weights a car takes for its own.
                extra_theta=("lane_weight",),
            )
        )
    return Game(tuple(players), horizon, (), dt)


def _state_bounds(kind: str, region: Region) -> Bounds:
    limit = kind_of(kind).speed_limit
    if is_vehicle(kind):  # does not reverse
        low, high = (0.0, -np.inf), (limit, np.inf)
    else:
        low, high = (-limit, -limit), (limit, limit)
    return Bounds.box([*region.low, *low], [*region.high, *high], 4)


def _control_bounds(walks: bool) -> Bounds:
    if walks:
        return Bounds.box(-WALKING_ACCELERATION_LIMIT, WALKING_ACCELERATION_LIMIT, 2)
    limit = np.array([ACCELERATION_LIMIT, STEERING_LIMIT])
    return Bounds.box(-limit, limit, 2)


def _region_constraints(
    walks: bool, region: Region, penalty: float | None
) -> tuple[Inequality, ...]:
    found = []
    if region.corners:
        shrink = PEDESTRIAN_SHRINK if walks else 1.0
        outside = OutsideCircles(region.corners, shrink)
        found.append(Inequality(outside, len(region.corners), penalty))
    if region.sides and not walks:
        found.append(Inequality(RoadBoundary(region.sides), len(region.sides), penalty))
    return tuple(found)


class IntersectionInstance(NamedTuple):
    """One intersection with its agents."""

    kinds: tuple[str, ...]
    lanes: tuple[Lane | None, ...]
    region: Region
    initial_state: Float[np.ndarray, "N 4"]
    """`[px, py, vx, vy]` of pedestrians, `[px, py, v, psi]` of cars."""
    goals: Float[np.ndarray, "N 2"]

    @property
    def theta(self) -> tuple[dict[str, Any], ...]:
        """Parameters for `intersection_game`, weights at their defaults."""
        return tuple(
            player_theta(kind, goal) for kind, goal in zip(self.kinds, self.goals, strict=True)
        )
