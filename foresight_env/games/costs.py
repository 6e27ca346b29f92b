"""Stage costs `cost(i, t, x, u, theta)`, each a small hashable object (paper, section VI).

A weight is a number, or the name of an entry of the player's `theta` when it is a parameter.
`Composite` costs declare how they curve: `loss` is convex, `residual` is what bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta
from foresight_env.games.vectors import squared_length

Weight = float | str


def weight_value(weight: Weight, theta: Theta) -> Scalar:
    """The number itself, or the entry of `theta` that `weight` names."""
    return jnp.asarray(theta[weight] if isinstance(weight, str) else weight)


@runtime_checkable
class Composite(Protocol):
    """A cost `loss(residual(...), theta)` with `loss` convex.

    Far from an equilibrium, solvers replace `residual` by its linearisation in second derivatives
    (Gauss-Newton), which keeps each player's own problem convex there.
    """

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "r"]: ...

    def loss(self, value: Float[Array, "r"], theta: Theta) -> Scalar: ...


def distances(i: int, x: States) -> Float[Array, "others"]:
    """Distances (m) from player `i` to every other player; states begin with the position."""
    others = [xj[:2] for j, xj in enumerate(x) if j != i]
    if not others:
        return jnp.zeros(0)
    squared = squared_length(x[i][:2] - jnp.stack(others))
    # The square root has no derivative at 0: agents exactly on top of each other get gradient 0.
    positive = jnp.where(squared > 0.0, squared, 1.0)
    return jnp.where(squared > 0.0, jnp.sqrt(positive), 0.0)


@dataclass(frozen=True)
class Goal(PermutationInvariant):
    """`w * ||p - goal||^2`, goal (2,) in metres from `theta[goal]`."""

    weight: Weight = 1.0
    goal: str = "goal"

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * squared_length(x[i][:2] - theta[self.goal])


@dataclass(frozen=True)
class Effort(PermutationInvariant):
    """`w * ||u||^2`."""

    weight: Weight = 0.1

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * squared_length(u[i])


@dataclass(frozen=True)
class SquaredDistanceHinge(PermutationInvariant):
    """`w * sum_j max(0, distance - ||p_i - p_j||)^2`: the reference implementation's proximity."""

    distance: Weight = 1.2
    weight: Weight = 5.0

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "others"]:
        return weight_value(self.distance, theta) - distances(i, x)

    def loss(self, value: Float[Array, "others"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(jnp.maximum(value, 0.0) ** 2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


@dataclass(frozen=True)
class SigmoidProximity(PermutationInvariant):
    """`w * sum_j 1 / (1 + exp(sharpness * (||p_i - p_j|| - distance)))` over `others` (inD game).

    `others`: indices of the players that count; None means all.
    """

    distance: Weight = 1.0
    weight: Weight = 1.0
    sharpness: float = 10.0
    others: tuple[int, ...] | None = None

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        chosen = [j for j in range(len(x)) if j != i and (self.others is None or j in self.others)]
        if not chosen:
            return jnp.zeros(())
        gap = distances(0, (x[i], *(x[j] for j in chosen))) - weight_value(self.distance, theta)
        return weight_value(self.weight, theta) * jnp.sum(jax.nn.sigmoid(-self.sharpness * gap))

    def distinguishes(self, i: int, j: int) -> bool:
        """Whether one of them counts for others and one does not."""
        return self.others is not None and (i in self.others) != (j in self.others)


@dataclass(frozen=True)
class TargetSpeed(PermutationInvariant):
    """`w * (v - target)^2` for states whose third entry is the speed (m/s), as a bicycle's."""

    target: Weight
    weight: Weight = 1.0

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        error = x[i][2] - weight_value(self.target, theta)
        return weight_value(self.weight, theta) * error**2


@dataclass(frozen=True)
class PreferredVelocity(PermutationInvariant):
    """`w * ||v - velocity||^2`, velocity (2,) in m/s from `theta`, of `[px, py, vx, vy]`."""

    weight: Weight
    velocity: str = "velocity"

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        error = x[i][2:4] - theta[self.velocity]
        return weight_value(self.weight, theta) * squared_length(error)
