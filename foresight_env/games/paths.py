"""Costs of cars that follow a path in the plane: how far off it they are, how near they come.

A path is an entry of `theta`, not part of the game: one compiled game serves every road. It is an
array (M, 4) of points `[px, py, heading, curvature]` (m, m, rad, 1/m) at even distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta

SOFTNESS = 1.5
"""Width of the neighbourhood that a car's offset is averaged over, m: with points every 2 m the
nearest two or three count, and no derivative jumps where another becomes the nearest."""

WINDOW = 16
"""Points around the nearest that count at all."""


# Inlined: a separate call is traced once, however many cars ask for their offsets.
@partial(jax.jit, inline=True)
def path_offset(path: Float[Array, "M 4"], position: Float[Array, "2"]) -> Scalar:
    """Distance (m) to the left of the path, smooth in the position, to be differentiated twice.

    Each point gives the offset from its osculating parabola, exact to second order in the distance
    along it; the points near the position are averaged.

    What is handed to the caller is the second-order expansion at the position itself: the same
    value and the same first and second derivatives by the position (further ones are zero), found
    in two directions once, instead of in as many as a game's Newton step has unknowns and as often
    as a cost or a constraint asks.
    """
    here = jax.lax.stop_gradient(position)
    # Beyond the window weights are below 1e-13, so that its moving on is not felt.
    value, slope, curvature = _expansion(_points_near(path, here), here)
    away = position - here
    bend = curvature[0] * away[0] ** 2 + curvature[2] * away[1] ** 2
    bend = 0.5 * bend + curvature[1] * away[0] * away[1]
    return value + slope[0] * away[0] + slope[1] * away[1] + bend


def _points_near(path: Float[Array, "M 4"], place: Float[Array, "2"]) -> Float[Array, "window 4"]:
    # A selection by position: what is averaged below changes smoothly all the same.
    nearest = jnp.argmin((path[:, 0] - place[0]) ** 2 + (path[:, 1] - place[1]) ** 2)
    size = min(WINDOW, path.shape[0])
    begin = jnp.clip(nearest - size // 2, 0, path.shape[0] - size)
    return jax.lax.dynamic_slice(path, (begin, 0), (size, 4))


def _expansion(
    path: Float[Array, "window 4"], place: Float[Array, "2"]
) -> tuple[Scalar, Float[Array, "2"], Float[Array, "3"]]:
    """The averaged offset (m) with its gradient and second derivatives (xx, xy, yy; 1/m).

    With weights `n_k` of the points, `l_k` the gradients of their logarithms less the mean of
    these, and offsets `f_k` less their mean F,

        grad F = E[grad f + f l],    hess F = E[hess f + grad f l' + l grad f' + f l l'].

    Written out by components: sums over two entries are slow in XLA (0.1 ms each in jaxlib 0.10,
    which hands them to a library).
    """
    x, y = place[0] - path[:, 0], place[1] - path[:, 1]
    cosine, sine, bend = jnp.cos(path[:, 2]), jnp.sin(path[:, 2]), path[:, 3]
    along, across = cosine * x + sine * y, cosine * y - sine * x
    weight = jax.nn.softmax(-0.5 * (x**2 + y**2) / SOFTNESS**2)
    offset = across - 0.5 * bend * along**2
    fx, fy = -sine - bend * along * cosine, cosine - bend * along * sine
    means = jnp.sum(weight * jnp.stack([offset, x, y]), axis=1)
    value = means[0]
    f, lx, ly = offset - value, (means[1] - x) / SOFTNESS**2, (means[2] - y) / SOFTNESS**2
    sums = jnp.sum(
        weight
        * jnp.stack(
            [
                fx + f * lx,
                fy + f * ly,
                -bend * cosine**2 + 2.0 * fx * lx + f * lx**2,
                -bend * cosine * sine + fx * ly + fy * lx + f * lx * ly,
                -bend * sine**2 + 2.0 * fy * ly + f * ly**2,
            ]
        ),
        axis=1,
    )
    return value, sums[:2], sums[2:]


@dataclass(frozen=True)
class PathFollowing(PermutationInvariant):
    """`w * offset^2` from the path in `theta`."""

    weight: Weight
    path: str = "path"

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "1"]:
        return path_offset(jnp.asarray(theta[self.path]), x[i][:2])[None]

    def loss(self, value: Float[Array, "1"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(value**2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


def arc_offset(anchor: Float[Array, "3"], curvature: Scalar, position: Float[Array, "2"]) -> Scalar:
    """Distance (m) to the left of the circle, or line, that leaves a pose `[px, py, heading]`.

    For a curvature `kappa` and a place at `(xi, eta)` in the pose's axes it is `(2 eta - kappa d^2)
    / (1 + sqrt(1 - 2 kappa eta + kappa^2 d^2))`, `d^2 = xi^2 + eta^2`: no difference of large
    numbers where the circle is nearly a line.
    """
    x, y = position[0] - anchor[0], position[1] - anchor[1]
    across = jnp.cos(anchor[2]) * y - jnp.sin(anchor[2]) * x
    squared = x**2 + y**2
    # The root is kappa times the distance to the circle's middle, where it has no derivative.
    root = jnp.maximum(1.0 - 2.0 * curvature * across + curvature**2 * squared, 1e-6)
    return (2.0 * across - curvature * squared) / (1.0 + jnp.sqrt(root))


@dataclass(frozen=True)
class ArcFollowing(PermutationInvariant):
    """`w * offset^2` from the arc that leaves the pose in `theta[anchor]` with a curvature there.

    For drivers whose route is not known: they keep to the lane that they are in.
    """

    weight: Weight
    curvature: Weight
    anchor: str = "anchor"

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "1"]:
        bend = weight_value(self.curvature, theta)
        return arc_offset(jnp.asarray(theta[self.anchor]), bend, x[i][:2])[None]

    def loss(self, value: Float[Array, "1"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(value**2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


@dataclass(frozen=True)
class FromStage(PermutationInvariant):
    """A `Composite` cost that counts from stage `theta[begin]` on.

    A route that begins where a driver is now says nothing about the way there.
    """

    cost: PathFollowing | ArcFollowing
    begin: str = "begin"

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "r"]:
        value = self.cost.residual(i, t, x, u, theta)
        return jnp.where(t >= jnp.asarray(theta[self.begin]), value, 0.0)

    def loss(self, value: Float[Array, "r"], theta: Theta) -> Scalar:
        return self.cost.loss(value, theta)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


@dataclass(frozen=True)
class LaneBounds(PermutationInvariant):
    """Constraint `half_width - |offset| >= 0` from the path in `theta`: its two sides (2,), m."""

    half_width: float
    path: str = "path"

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "2"]:
        offset = path_offset(jnp.asarray(theta[self.path]), x[i][:2])
        return self.half_width + jnp.stack([-offset, offset])


@dataclass(frozen=True)
class FootprintProximity(PermutationInvariant):
    """`w * sum max(0, distance - d)^2` over pairs of own and others' discs, `d` between centres.

    Every car is covered by two discs, `reach` m before and behind its middle along its heading.
    """

    distance: Weight
    weight: Weight
    reach: float = 1.25

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "gaps"]:
        own = self._discs(x[i])
        others = [disc for j, state in enumerate(x) if j != i for disc in self._discs(state)]
        if not others:
            return jnp.zeros(0)
        squared = jnp.stack([(a - c) ** 2 + (b - d) ** 2 for a, b in own for c, d in others])
        # The square root has no derivative at 0: discs exactly on top of each other get gradient 0.
        positive = jnp.where(squared > 0.0, squared, 1.0)
        apart = jnp.where(squared > 0.0, jnp.sqrt(positive), 0.0)
        return weight_value(self.distance, theta) - apart

    def loss(self, value: Float[Array, "gaps"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(jnp.maximum(value, 0.0) ** 2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)

    def _discs(self, state: Float[Array, "4"]) -> list[tuple[Scalar, Scalar]]:
        ahead, aside = self.reach * jnp.cos(state[3]), self.reach * jnp.sin(state[3])
        return [(state[0] + ahead, state[1] + aside), (state[0] - ahead, state[1] - aside)]
