"""An encounter on open ground, for recordings: people and vehicles keep their pace and make way.

People have a velocity that they would keep, vehicles a speed and a curvature of their path. All pay
for leaving it and for coming too close. Units: metres, seconds, radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.constraints import Bounds
from foresight_env.games.costs import (
    Effort,
    PreferredVelocity,
    TargetSpeed,
    Weight,
    distances,
    weight_value,
)
from foresight_env.games.dynamics import CurvatureVehicle, DoubleIntegrator
from foresight_env.games.game import Game, Player
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.steering import Steering
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta

CRUISE_WEIGHT = 0.5
CONTROL_WEIGHT = 1.0
TURN_WEIGHT = 100.0
"""Of a vehicle's leaving the curvature that it would keep, m^2."""
COLLISION_WEIGHT = 0.3
ACCELERATION_LIMIT = 5.0
"""People per axis, vehicles along their heading, m/s^2: harder than people walk and cars brake in
ordinary traffic."""
CURVATURE_LIMIT = 0.3
"""1/m: a turning circle of 3.3 m, tighter than cars can."""
PERSONAL_SPACE = {"pedestrian": 0.3, "bicycle": 0.5}
"""Radius that people keep free around their centre towards each other, m."""
VEHICLE_BERTH = 4.0
"""Further distance that people and vehicles keep between each other's centres, m: people slow down
for a vehicle early. Chosen, with `COLLISION_WEIGHT`, on the development recordings."""
VEHICLE_DISTANCE = 6.0
"""Distance between two vehicles' centres, m: a length and a gap."""


def wanted_distance(kind: str, other: str) -> float:
    """Distance between centres (m) below which agents of these kinds pay."""
    if is_vehicle(kind) and is_vehicle(other):
        return VEHICLE_DISTANCE
    berth = VEHICLE_BERTH if is_vehicle(kind) or is_vehicle(other) else 0.0
    return berth + PERSONAL_SPACE.get(kind, 0.0) + PERSONAL_SPACE.get(other, 0.0)


@dataclass(frozen=True)
class Crowding(PermutationInvariant):
    """`w * sum_j max(0, d_ij - ||p_i - p_j||)^2`, `d_ij` the distance that i wants of j."""

    wanted: tuple[tuple[float, ...], ...]
    weight: Weight

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "others"]:
        return jnp.asarray(self._of_others(i)) - distances(i, x)

    def loss(self, value: Float[Array, "others"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(jnp.maximum(value, 0.0) ** 2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)

    def distinguishes(self, i: int, j: int) -> bool:
        """Whether they want other distances of the others."""
        return self._of_others(i) != self._of_others(j)

    def _of_others(self, i: int) -> tuple[float, ...]:
        return tuple(d for j, d in enumerate(self.wanted[i]) if j != i)


def player_theta(kind: str, preferred_motion: Any) -> dict[str, Any]:
    """One player's parameters: what it would keep, and the weights of its costs.

    `preferred_motion`: the velocity (2,) of people, `(speed, curvature)` of vehicles.
    """
    weights = {
        "cruise_weight": CRUISE_WEIGHT,
        "control_weight": CONTROL_WEIGHT,
        "collision_weight": COLLISION_WEIGHT,
    }
    if is_vehicle(kind):
        speed, curvature = preferred_motion
        return {**weights, "speed": speed, "curvature": curvature, "turn_weight": TURN_WEIGHT}
    return {**weights, "velocity": preferred_motion}


ALONE_UNREAD = ("collision_weight",)
"""Entries of `theta` that nothing reads of an agent that meets no other."""


@lru_cache(maxsize=64)
def encounter_game(kinds: tuple[str, ...], horizon: int, dt: float) -> Game:
    """The game between agents of these kinds; `theta` as `player_theta` makes it.

    States are `[px, py, vx, vy]` of people and `[px, py, v, psi]` of vehicles.
    """
    if not kinds:
        raise ValueError("kinds: is empty; expected one kind per agent")
    wanted = tuple(tuple(wanted_distance(a, b) for b in kinds) for a in kinds)
    crowding = (Crowding(wanted, "collision_weight"),) if len(kinds) > 1 else ()
    steering = ACCELERATION_LIMIT, CURVATURE_LIMIT
    vehicle = Player(
        CurvatureVehicle(dt),
        (
            TargetSpeed("speed", "cruise_weight"),
            Steering("control_weight", "turn_weight", "curvature"),
            *crowding,
        ),
        control_bounds=Bounds.box([-bound for bound in steering], steering, 2),
        extra_theta=ALONE_UNREAD,
    )
    walker = Player(
        DoubleIntegrator(dt),
        (PreferredVelocity("cruise_weight"), Effort("control_weight"), *crowding),
        control_bounds=Bounds.box(-ACCELERATION_LIMIT, ACCELERATION_LIMIT, 2),
        extra_theta=ALONE_UNREAD,
    )
    return Game(tuple(vehicle if is_vehicle(k) else walker for k in kinds), horizon, (), dt)
