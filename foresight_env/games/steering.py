"""What vehicles pay for their controls."""

from __future__ import annotations

from dataclasses import dataclass

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
