"""Cost of conflicts between road users: bodies that come close, now or a time gap ahead."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta


@dataclass(frozen=True)
class Body:
    """Room that a road user takes.

    A vehicle has the state `[px, py, v, psi, ...]`, all others `[px, py, vx, vy]`.
    """

    vehicle: bool
    half_width: float
    """m; the radius of those who are no vehicles."""
    half_length: float = 0.0
    """m, of vehicles."""
    headway: float = 0.0
    """Time gap that a vehicle's driver keeps ahead, s."""


@dataclass(frozen=True)
class Conflict(PermutationInvariant):
    """`w * sum_j r_ij^2`: how deep others are in the room that a road user keeps free, m.

    Around a vehicle that is an ellipse: across it `b = half_width + r + margin` from its middle,
    behind it `a = half_length + r + margin`, ahead of it `a + headway * v`, with `r` the radius of
    the other. At `(xi, eta)` in the vehicle's axes the depth is `r_ij = max(0, 1 - rho) b` with
    `rho^2 = (xi / a)^2 + (eta / b)^2`: it grows all the way to the middle. Between two vehicles
    each looks from its own ellipse at two discs at the ends of the other. People and bicycles count
    their depth in a vehicle's ellipse, and in discs around each other.
    """

    bodies: tuple[Body, ...]
    margins: tuple[tuple[float, ...], ...]
    """m, per player and other player."""
    weight: Weight

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "depths"]:
        mine, depths = self.bodies[i], []
        for j, other in enumerate(self.bodies):
            if j == i:
                continue
            margin = self.margins[i][j]
            if mine.vehicle and other.vehicle:
                depths += [_depth(mine, x[i], disc, other, margin) for disc in _discs(other, x[j])]
            elif mine.vehicle:
                depths.append(_depth(mine, x[i], (x[j][0], x[j][1]), other, margin))
            elif other.vehicle:
                depths.append(_depth(other, x[j], (x[i][0], x[i][1]), mine, margin))
            else:
                apart = _length(x[i][0] - x[j][0], x[i][1] - x[j][1])
                depths.append(mine.half_width + other.half_width + margin - apart)
        return jnp.stack(depths) if depths else jnp.zeros(0)

    def loss(self, value: Float[Array, "depths"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(jnp.maximum(value, 0.0) ** 2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)

    def distinguishes(self, i: int, j: int) -> bool:
        """Whether the two differ in their bodies, or in what they see of others."""

        def seen(k: int) -> tuple[object, ...]:
            others = [m for m in range(len(self.bodies)) if m != k]
            return self.bodies[k], tuple((self.bodies[m], self.margins[k][m]) for m in others)

        return seen(i) != seen(j)


Position = tuple[Scalar, Scalar]
"""m."""


def _depth(
    vehicle: Body, state: Float[Array, "_"], place: Position, other: Body, margin: float
) -> Scalar:
    """`b (1 - rho)` of a place in a vehicle's ellipse, m."""
    x, y = place[0] - state[0], place[1] - state[1]
    cosine, sine = jnp.cos(state[3]), jnp.sin(state[3])
    along, across = cosine * x + sine * y, cosine * y - sine * x
    wide = vehicle.half_width + other.half_width + margin
    long = vehicle.half_length + other.half_width + margin
    ahead = long + vehicle.headway * jnp.maximum(state[2], 0.0)
    return wide * (1.0 - _length(along / jnp.where(along > 0.0, ahead, long), across / wide))


def _discs(body: Body, state: Float[Array, "_"]) -> tuple[Position, Position]:
    """Middles of two discs of `half_width`, at the ends of a vehicle."""
    reach = body.half_length - body.half_width
    ahead, aside = reach * jnp.cos(state[3]), reach * jnp.sin(state[3])
    return (state[0] + ahead, state[1] + aside), (state[0] - ahead, state[1] - aside)


def _length(x: Scalar, y: Scalar) -> Scalar:
    squared = x**2 + y**2
    # The square root has no derivative at 0: bodies exactly on top of each other get gradient 0.
    positive = jnp.where(squared > 0.0, squared, 1.0)
    return jnp.where(squared > 0.0, jnp.sqrt(positive), 0.0)
