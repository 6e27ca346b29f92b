"""Control costs and limits of vehicles."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta


@dataclass(frozen=True)
class Steering(PermutationInvariant):
    """`w_a * acceleration^2 + w_s * (steering - wanted)^2`, the two controls of a `Vehicle`.

    `wanted`: the steering angle (rad) or curvature (1/m) that it would keep.
    """

    weight: Weight
    steering_weight: Weight
    wanted: Weight = 0.0

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        acceleration, steering = u[i]
        wanted = weight_value(self.wanted, theta)
        return (
            weight_value(self.weight, theta) * acceleration**2
            + weight_value(self.steering_weight, theta) * (steering - wanted) ** 2
        )


@dataclass(frozen=True)
class Comfort(PermutationInvariant):
    """Cost of acceleration, jerk and steering of a `SmoothVehicle`.

    `w_a a^2 + w_j jerk^2 + w_k (kappa - curvature)^2 + w_r curvature_rate^2 + w_l (v^2 kappa)^2`.
    """

    acceleration: Weight
    jerk: Weight
    curvature: Weight
    curvature_rate: Weight
    lateral_acceleration: Weight
    settled: Weight = 0.0
    """Curvature (1/m) that the driver would keep."""

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "5"]:
        speed, acceleration, curvature = x[i][2], x[i][4], x[i][5]
        jerk, rate = u[i]
        turn = curvature - weight_value(self.settled, theta)
        return jnp.stack([acceleration, jerk, turn, rate, speed**2 * curvature])

    def loss(self, value: Float[Array, "5"], theta: Theta) -> Scalar:
        weights = (
            self.acceleration,
            self.jerk,
            self.curvature,
            self.curvature_rate,
            self.lateral_acceleration,
        )
        return jnp.sum(jnp.stack([weight_value(w, theta) for w in weights]) * value**2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


@dataclass(frozen=True)
class DrivingLimits(PermutationInvariant):
    """Constraint of a `SmoothVehicle`: no reversing, `|v^2 kappa|` at most `lateral`; (3,).

    Rows: speed (m/s), distance of the lateral acceleration from its two limits (m/s^2).
    """

    lateral: float

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "3"]:
        speed, curvature = x[i][2], x[i][5]
        across = speed**2 * curvature
        return jnp.stack([speed, self.lateral - across, self.lateral + across])
