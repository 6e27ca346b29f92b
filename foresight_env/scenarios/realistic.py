"""Realistic traffic, for recordings: cars that steer and brake smoothly, and people.

A driver has a preferred speed and a route, or a curvature to settle at where no route is known; a
person or a bicycle a preferred velocity. All pay for leaving them, for what is uncomfortable, and
for conflicts with others, seen by their footprints and a time gap ahead. Discount factors are per
second. Units: metres, seconds, radians.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.games.conflict import Body, Conflict
from foresight_env.games.constraints import Bounds, Inequality
from foresight_env.games.costs import Effort, PreferredVelocity, TargetSpeed
from foresight_env.games.discounting import ExponentialPerSecond
from foresight_env.games.dynamics import DoubleIntegrator, SmoothVehicle
from foresight_env.games.game import Game, Player
from foresight_env.games.kinds import is_vehicle, kind_of
from foresight_env.games.paths import ArcFollowing, FromStage, PathFollowing
from foresight_env.games.steering import Comfort, DrivingLimits

LEAST_ACCELERATION, MOST_ACCELERATION = -8.0, 4.0
"""m/s^2, of cars: emergency braking on a dry road, and a strong start."""
MOST_CURVATURE = 0.25
"""1/m: a wheelbase of 2.7 m and a steering angle of 34 degrees."""
MOST_JERK = 15.0
"""m/s^3, of cars: an emergency stop."""
MOST_CURVATURE_RATE = 0.4
"""1/(m s): the steering wheel from lock to lock in just over a second."""
MOST_LATERAL_ACCELERATION = 2.8
"""m/s^2: recorded drivers stay below it at junctions."""
LIMIT_PENALTY = 50.0
"""Per m/s or m/s^2 beyond the limits of driving and stage: estimated states may lie there."""
WALKING_ACCELERATION = 5.0
"""m/s^2 per axis, of people and bicycles."""


class DrivingWeights(NamedTuple):
    """Weights of a driver's costs, relative to that of squared jerk.

    Chosen, as those of `WalkingWeights`, on the development recordings of
    `evaluation.windows.interaction` by the predictions' errors.
    """

    speed_weight: float = 0.15
    """s^-4: of squared differences from the preferred speed."""
    acceleration_weight: float = 0.12
    """s^-2."""
    jerk_weight: float = 1.0
    curvature_weight: float = 100.0
    """m^4 s^-6, of squared differences from the curvature to settle at."""
    curvature_rate_weight: float = 400.0
    """m^4 s^-4."""
    lateral_weight: float = 0.035
    """s^-2, of squared lateral accelerations."""
    path_weight: float = 3.0
    """s^-6, of squared distances from the route."""
    collision_weight: float = 0.5
    """s^-6, of squared depths of conflicts (`Conflict`)."""


class WalkingWeights(NamedTuple):
    """Weights of the costs of a person or a bicycle, relative to that of squared acceleration."""

    velocity_weight: float = 1.3
    """s^-2."""
    control_weight: float = 1.0
    collision_weight: float = 0.6
    """s^-4."""


class PreferredMotion(NamedTuple):
    """Preferred motion of a driver: a speed, along a route, or an arc where none is known."""

    speed: Any
    """m/s."""
    anchor: Float[np.ndarray, "3"]
    """Pose `[px, py, heading]` at which the arc begins: where the driver is now."""
    curvature: Any = 0.0
    """Of the arc, 1/m."""
    path: Float[np.ndarray, "M 4"] | None = None
    """Route: points `[px, py, heading, curvature]` at even distances of 1 to 2 m."""
    begin: int = 1
    """Stage from which on the driver keeps to it."""


HEADWAY = 0.6
"""Time gap that drivers keep, s."""
DRIVING_MARGIN = 1.0
"""Gap between a vehicle's footprint and another one, m."""
WALKING_MARGIN = 0.0
"""Gap between people, m."""


def driver_theta(
    preferred: PreferredMotion, weights: DrivingWeights = DrivingWeights()
) -> dict[str, Any]:
    """Return the parameters of a driver for `realistic_game`: preferred motion and weights."""
    theta = {"speed": preferred.speed, "begin": float(preferred.begin), **weights._asdict()}
    if preferred.path is None:
        return {**theta, "curvature": preferred.curvature, "anchor": preferred.anchor}
    del theta["curvature_weight"]
    return {**theta, "path": preferred.path}


def walker_theta(velocity: Any, weights: WalkingWeights = WalkingWeights()) -> dict[str, Any]:
    """Return the parameters of a person or a bicycle: preferred velocity (2,) in m/s, weights."""
    return {"velocity": velocity, **weights._asdict()}


@lru_cache(maxsize=64)
def realistic_game(
    kinds: tuple[str, ...], routed: tuple[bool, ...], horizon: int, dt: float
) -> Game:
    """Return the game between road users of these kinds.

    Args:
        kinds: Per agent: "pedestrian", "bicycle", or a vehicle's kind.
        routed: Per agent, whether it is a vehicle whose route is known.
        horizon: Stages.
        dt: s per stage.

    Returns:
        A game whose `theta` is made by `driver_theta` and `walker_theta`. States are `[px, py, v,
        psi, a, kappa]` of vehicles (`SmoothVehicle`), `[px, py, vx, vy]` of the others.

    Raises:
        ValueError: no agents, `routed` of another length, or a route for one who does not drive.
    """
    if not kinds:
        raise ValueError("kinds: is empty; expected one kind per agent")
    if len(routed) != len(kinds):
        raise ValueError(f"routed: has {len(routed)} entries; expected one per agent, {len(kinds)}")
    for i, kind in enumerate(kinds):
        if routed[i] and not is_vehicle(kind):
            raise ValueError(f"routed[{i}]: agent {i} is a {kind}; only vehicles have routes")
    conflict = (_conflict(kinds),) if len(kinds) > 1 else ()
    players = []
    for kind, on_route in zip(kinds, routed, strict=True):
        make = _driver if is_vehicle(kind) else _walker
        players.append(make(dt, on_route, conflict))
    return Game(tuple(players), horizon, (), dt)


def _driver(dt: float, routed: bool, conflict: tuple[Conflict, ...]) -> Player:
    free = float("inf")
    comfort = Comfort(
        "acceleration_weight",
        "jerk_weight",
        0.0 if routed else "curvature_weight",
        "curvature_rate_weight",
        "lateral_weight",
        0.0 if routed else "curvature",
    )
    along = PathFollowing("path_weight") if routed else ArcFollowing("path_weight", "curvature")
    low = (-free, -free, -free, -free, LEAST_ACCELERATION, -MOST_CURVATURE)
    high = (free, free, free, free, MOST_ACCELERATION, MOST_CURVATURE)
    limit = np.array([MOST_JERK, MOST_CURVATURE_RATE])
    return Player(
        SmoothVehicle(dt),
        (TargetSpeed("speed", "speed_weight"), comfort, FromStage(along), *conflict),
        discounting=ExponentialPerSecond(dt),
        state_bounds=Bounds.box(low, high, 6),
        control_bounds=Bounds.box(-limit, limit, 2),
        inequalities=(Inequality(DrivingLimits(MOST_LATERAL_ACCELERATION), 3, LIMIT_PENALTY),),
        extra_theta=("collision_weight",),  # of a single agent
    )


def _walker(dt: float, routed: bool, conflict: tuple[Conflict, ...]) -> Player:
    return Player(
        DoubleIntegrator(dt),
        (PreferredVelocity("velocity_weight"), Effort("control_weight"), *conflict),
        discounting=ExponentialPerSecond(dt),
        control_bounds=Bounds.box(-WALKING_ACCELERATION, WALKING_ACCELERATION, 2),
        extra_theta=("collision_weight",),
    )


def _conflict(kinds: tuple[str, ...]) -> Conflict:
    driving = [is_vehicle(kind) for kind in kinds]
    margins = tuple(
        tuple(DRIVING_MARGIN if a or b else WALKING_MARGIN for b in driving) for a in driving
    )
    return Conflict(tuple(_body(kind) for kind in kinds), margins, "collision_weight")


def _body(kind: str) -> Body:
    usual = kind_of(kind)
    headway = HEADWAY if usual.vehicle else 0.0
    return Body(usual.vehicle, 0.5 * usual.width, 0.5 * usual.length, headway)
