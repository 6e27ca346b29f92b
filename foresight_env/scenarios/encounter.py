"""An encounter on open ground, for recordings: people and vehicles keep their pace and make way.

Every agent has a velocity that it would keep (where it is heading and how fast), pays for changing
it, and pays for coming too close. Double integrators serve people and, over a few seconds,
vehicles. Units: metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.constraints import Bounds
from foresight_env.games.costs import Effort, Weight, distances, weight_value
from foresight_env.games.dynamics import DoubleIntegrator
from foresight_env.games.game import Game, Player
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta

CRUISE_WEIGHT = 0.3
CONTROL_WEIGHT = 1.0
COLLISION_WEIGHT = 3.0
ACCELERATION_LIMIT = 5.0
"""Per axis, m/s^2: harder than people walk and cars brake in ordinary traffic."""
PERSONAL_SPACE = {"pedestrian": 0.6, "bicycle": 0.8}
"""Radius that an agent of each kind keeps free around its centre, m; vehicles see below."""
VEHICLE_SPACE = 1.8


def personal_space(kind: str) -> float:
    """Radius (m) that an agent of this kind keeps free around its centre."""
    return PERSONAL_SPACE.get(kind, VEHICLE_SPACE)


@dataclass(frozen=True)
class Cruise:
    """`w * ||v - velocity||^2` with the wanted velocity (2,) in `theta`, m/s."""

    weight: Weight
    velocity: str = "velocity"

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        error = x[i][2:4] - theta[self.velocity]
        return weight_value(self.weight, theta) * jnp.sum(error**2)


@dataclass(frozen=True)
class Crowding:
    """`w * sum_j max(0, r_i + r_j - ||p_i - p_j||)^2`, `r` the radii of everybody's space."""

    radii: tuple[float, ...]
    weight: Weight

    def inner(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "others"]:
        wanted = [self.radii[i] + r for j, r in enumerate(self.radii) if j != i]
        return jnp.asarray(wanted) - distances(i, x)

    def outer(self, value: Float[Array, "others"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(jnp.maximum(value, 0.0) ** 2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.outer(self.inner(i, t, x, u, theta), theta)


def player_theta(velocity: Any) -> dict[str, Any]:
    """One player's parameters: the velocity (2,) it would keep and the weights of its costs."""
    return {
        "velocity": velocity,
        "cruise_weight": CRUISE_WEIGHT,
        "control_weight": CONTROL_WEIGHT,
        "collision_weight": COLLISION_WEIGHT,
    }


@lru_cache(maxsize=64)
def encounter_game(kinds: tuple[str, ...], horizon: int, dt: float) -> Game:
    """The game between agents of these kinds; `theta` as `player_theta` makes it."""
    if not kinds:
        raise ValueError("kinds: is empty; expected one kind per agent")
    radii = tuple(personal_space(kind) for kind in kinds)
    costs: tuple[Any, ...] = (Cruise("cruise_weight"), Effort("control_weight"))
    if len(kinds) > 1:
        costs = (*costs, Crowding(radii, "collision_weight"))
    limits = Bounds.box(-ACCELERATION_LIMIT, ACCELERATION_LIMIT, 2)
    player = Player(DoubleIntegrator(dt), costs, control_bounds=limits)
    return Game((player,) * len(kinds), horizon, (), dt)
