"""Constraints and costs of roads: corners, road sides and lane centres (paper, section VI-B).

Geometry is part of the game, in metres; what an agent makes of it (weights) is in `theta`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import AnyArray, Controls, Scalar, StageNumber, States, Theta
from foresight_env.games.vectors import components, dot, squared_length

Point = tuple[float, float]
FINE = 0.1
"""Distance of the points between which centre lines are interpolated, m."""


@dataclass(frozen=True)
class Circle:
    """A disc that must not be entered: a building's corner, an island."""

    center: Point
    radius: float

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.center, self.radius]).all() and self.radius > 0.0):
            raise ValueError(
                f"center, radius: are {self.center} and {self.radius}; expected finite numbers and "
                "a radius above 0"
            )

    @staticmethod
    def through(a: Point, b: Point, c: Point) -> Circle:
        """Return the circle through three points.

        Args:
            a, b, c: (2,) m.

        Returns:
            The circle.

        Raises:
            ValueError: the points lie on one line or are not finite.
        """
        points = np.array([a, b, c], dtype=float)
        # ||p - m||^2 = r^2 for all three, differences of pairs: linear in m.
        matrix = 2.0 * (points[1:] - points[0])
        finite = np.isfinite(points).all()
        if not finite or abs(np.linalg.det(matrix)) < 1e-9 * max(1.0, np.abs(points).max()):
            raise ValueError(
                f"a, b, c: no circle goes through {a}, {b}, {c}: they lie on one line, or are not "
                "finite"
            )
        right = np.sum(points[1:] ** 2 - points[0] ** 2, axis=1)
        center = np.linalg.solve(matrix, right)
        x, y = (float(v) for v in center)
        return Circle((x, y), float(np.linalg.norm(points[0] - center)))


@dataclass(frozen=True)
class RoadSide:
    """The side of a road that leaves an intersection at `start` and runs through `end` and on.

    Behind `start` the road opens into the intersection (`RoadBoundary` says how).
    """

    start: Point
    end: Point
    road: Literal["left", "right"]
    """Side on which the road is, looking from `start` to `end`."""

    def __post_init__(self) -> None:
        if self.road not in ("left", "right"):
            raise ValueError(f'road: is {self.road!r}; expected "left" or "right"')
        if not np.isfinite([self.start, self.end]).all() or self.start == self.end:
            raise ValueError(
                f"start, end: are {self.start} and {self.end}; expected two different places"
            )


@dataclass(frozen=True)
class OutsideCircles(PermutationInvariant):
    """`||p - center||^2 - (shrink * radius)^2` for every circle, (circles,), m^2."""

    circles: tuple[Circle, ...]
    shrink: float = 1.0

    def __post_init__(self) -> None:
        if not self.circles or not self.shrink > 0.0:
            raise ValueError(
                f"circles, shrink: {len(self.circles)} circles and {self.shrink}; expected at "
                "least one circle and more than 0"
            )

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "circles"]:
        centers = jnp.asarray([c.center for c in self.circles])
        radii = self.shrink * jnp.asarray([c.radius for c in self.circles])
        return squared_length(x[i][:2] - centers) - radii**2


@dataclass(frozen=True)
class RoadBoundary(PermutationInvariant):
    """Signed distance (m) to every road side, positive on the road, (sides,).

    A sigmoid along the side lifts the distance by `lift` metres behind `start`, and by half of that
    at `start`; with `sharpness` 2 /m a hundredth of it is left 2.3 m down the road. Behind `start`
    no agent is to be farther than `lift` from the side's line.
    """

    sides: tuple[RoadSide, ...]
    sharpness: float = 2.0
    lift: float = 50.0

    def __post_init__(self) -> None:
        if not self.sides:
            raise ValueError("sides: is empty; expected at least one road side")
        if not (self.sharpness > 0.0 and self.lift > 0.0):
            raise ValueError(
                f"sharpness, lift: are {self.sharpness} and {self.lift}; expected more than 0"
            )

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "sides"]:
        starts = np.array([s.start for s in self.sides])
        along = np.array([s.end for s in self.sides]) - starts
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        sign = np.array([1.0 if s.road == "left" else -1.0 for s in self.sides])
        inward = sign[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
        offset = x[i][:2] - starts
        ahead = dot(offset, along)
        lift = self.lift * jax.nn.sigmoid(-self.sharpness * ahead)
        return dot(offset, inward) + lift


@dataclass(frozen=True)
class Lane:
    """A lane's centre line: `across = polynomial(ahead)` in a frame at `origin`, turned by `angle`.

    `coefficients`: highest power first, as `numpy.polyfit` returns them; metres. Before and behind
    `reach` (m ahead) the line continues straight: a polynomial is arbitrary beyond its points.
    """

    coefficients: tuple[float, ...]
    origin: Point = (0.0, 0.0)
    angle: float = 0.0
    reach: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        if not self.reach[0] < self.reach[1]:
            raise ValueError(f"reach: is {self.reach}; expected (from, to), from below to")

    @staticmethod
    def fit(points: Float[np.ndarray, "K 2"], degree: int = 4) -> Lane:
        """Return the lane that fits points of a centre line by least squares.

        Args:
            points: (K, 2) m, K >= 2, in driving order.
            degree: of the polynomial, in the frame of the first and the last point.

        Returns:
            The lane.

        Raises:
            ValueError: fewer than two points, a negative degree, or a line that turns back against
                its chord, which is no function in that frame.
        """
        if degree < 0:
            raise ValueError(f"degree: is {degree}; expected 0 or more")
        places = np.asarray(points, dtype=float)
        if places.ndim != 2 or places.shape[1] != 2 or len(places) < 2:
            raise ValueError(f"points: have shape {places.shape}; expected (K, 2), K at least 2")
        if not np.isfinite(places).all():
            raise ValueError("points: hold NaN or infinity; leave missing points out")
        chord = places[-1] - places[0]
        length = float(np.hypot(*chord))
        if length == 0.0:
            raise ValueError("points: begin and end at the same place; a lane needs a direction")
        angle = float(np.arctan2(chord[1], chord[0]))
        cosine, sine = chord / length
        turned = (places - places[0]) @ np.array([[cosine, -sine], [sine, cosine]])
        back = float(np.min(np.diff(turned[:, 0])))
        if back < -0.05 * length:
            raise ValueError(
                f"points: run back by {-back:.2f} m against the way from the first to the last; "
                "cut the lane into parts that do not"
            )
        # No more powers than different places ahead identify.
        spots = len(np.unique(np.round(turned[:, 0], 3)))
        powers = np.polyfit(turned[:, 0], turned[:, 1], min(degree, spots - 1))
        return Lane(
            tuple(float(c) for c in powers),
            (float(places[0, 0]), float(places[0, 1])),
            angle,
            (0.0, length),
        )

    def offset(self, position: Float[AnyArray, "2"]) -> Scalar:
        """Distance (m) to the centre line, to first order, positive on its left.

        The distance across the frame over `sqrt(1 + slope^2)`: exact for a straight lane.
        """
        return lane_offset(self.arrays, position)

    def centre_line(self, begin: Point, end: Point) -> Float[np.ndarray, "M 4"]:
        """Return the centre line between two places as points `[px, py, heading, curvature]`.

        Args:
            begin: a place next to its beginning, m.
            end: a place next to its end, m; the headings lead from the beginning to the end.

        Returns:
            Points 1 m apart (m, m, rad, 1/m).
        """
        direction = np.array([np.cos(self.angle), np.sin(self.angle)])
        first, last = (float(direction @ (np.array(p) - self.origin)) for p in (begin, end))
        ahead = np.linspace(first, last, max(int(abs(last - first) / FINE), 1) + 1)
        inside = np.clip(ahead, *self.reach)
        line = np.asarray(self.coefficients, dtype=float)
        slope = np.polyval(np.polyder(line), inside)
        across = np.polyval(line, inside) + slope * (ahead - inside)
        bend = np.where(ahead == inside, np.polyval(np.polyder(line, 2), inside), 0.0)
        back = last < first
        left = np.array([-direction[1], direction[0]])
        fine = np.column_stack(
            [
                np.array(self.origin) + np.outer(ahead, direction) + np.outer(across, left),
                self.angle + np.arctan(slope) + np.pi * back,
                (-1.0 if back else 1.0) * bend / (1.0 + slope**2) ** 1.5,
            ]
        )
        passed = np.cumsum(np.hypot(*np.diff(fine[:, :2], axis=0, prepend=fine[:1, :2]).T))
        at = np.arange(0.0, passed[-1])
        return np.stack([np.interp(at, passed, column) for column in fine.T], axis=1)

    @cached_property
    def arrays(self) -> LaneArrays:
        """The same as arrays, those of most lanes of the same shapes."""
        line = np.asarray(self.coefficients, dtype=float)
        slope = np.polyder(line)
        size = max(LANE_COEFFICIENTS, line.size)
        both = [np.pad(v, (size - v.size, 0)) for v in (line, slope)]
        direction = np.array([np.cos(self.angle), np.sin(self.angle)])
        return LaneArrays(
            np.stack(both, axis=1), np.array(self.origin), direction, np.array(self.reach)
        )

    def _line(self, ahead: Any) -> Any:
        """The centre line across the frame."""
        powers = np.asarray(self.coefficients)
        inside = np.clip(ahead, *self.reach)
        slope = np.polyval(np.polyder(powers), inside)
        return np.polyval(powers, inside) + slope * (ahead - inside)

    def points(self, ahead: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K 2"]:
        """Places on the centre line at these distances along the frame, for pictures."""
        across = self._line(np.asarray(ahead, dtype=float))
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        turned = np.stack([cosine * ahead - sine * across, sine * ahead + cosine * across], axis=1)
        return turned + np.asarray(self.origin)


LANE_COEFFICIENTS = 5
"""Coefficients that lanes of fewer are padded to: a polynomial of fourth degree, the published."""


class LaneArrays(NamedTuple):
    """A `Lane` as arrays."""

    coefficients: Float[AnyArray, "k 2"]
    """Of the line and of its slope, highest power first."""
    origin: Float[AnyArray, "2"]
    direction: Float[AnyArray, "2"]
    """Cosine and sine of the angle."""
    reach: Float[AnyArray, "2"]


def lane_offset(lane: LaneArrays, position: Float[AnyArray, "2"]) -> Scalar:
    """Return `Lane.offset` of a lane given as arrays."""
    east, north = components(position - lane.origin)
    cosine, sine = components(lane.direction)
    ahead = cosine * east + sine * north
    across = cosine * north - sine * east
    inside = jnp.clip(ahead, *components(lane.reach))
    both, *rest = lane.coefficients
    both = jnp.asarray(both)
    for coefficients in rest:  # Horner's rule, for line and slope at once
        both = both * inside + coefficients
    line, slope = components(both)
    line = line + slope * (ahead - inside)
    return jnp.asarray(across - line) / jnp.sqrt(1.0 + slope**2)


@dataclass(frozen=True)
class LaneCenter(PermutationInvariant):
    """`w * offset^2`: squared distance to the lane's centre line (paper, section VI-B)."""

    lane: Lane
    weight: Weight = 1.0

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "1"]:
        return jnp.reshape(self.lane.offset(x[i][:2]), (1,))

    def loss(self, value: Float[Array, "1"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(value**2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)

    def constants(self) -> LaneArrays:
        """See `Parametric`: cars on different lanes are identical players."""
        return self.lane.arrays

    def without_constants(self) -> _LaneCenterOf:
        """See `Parametric`."""
        return _LaneCenterOf(self.weight)


@dataclass(frozen=True)
class _LaneCenterOf(PermutationInvariant):
    """`LaneCenter` of a lane that is given as arrays."""

    weight: Weight
    lane: LaneArrays | None = field(default=None, compare=False)

    def with_constants(self, constants: LaneArrays) -> _LaneCenterOf:
        """See `Parametric`."""
        return replace(self, lane=constants)

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "1"]:
        assert self.lane is not None
        return jnp.reshape(lane_offset(self.lane, x[i][:2]), (1,))

    def loss(self, value: Float[Array, "1"], theta: Theta) -> Scalar:
        return weight_value(self.weight, theta) * jnp.sum(value**2)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)
