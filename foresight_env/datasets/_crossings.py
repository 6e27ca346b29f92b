"""Crossings and near approaches of two paths: polylines, with the times at which each is passed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from foresight_env.datasets.track import Track

# Segments are compared block against block, after the blocks' boxes were: long tracks (thousands
# of rows in inD) would otherwise need millions of comparisons per pair.
_BLOCK = 32
_BLOCK_PAIRS_AT_ONCE = 256
_ROUNDING = 1e-9
"""Of a segment's length, by which a crossing may lie beyond its ends."""


@dataclass(frozen=True, eq=False)
class Path:
    """One agent's path: the segments between successive rows, gaps left out.

    Attributes:
        start, end: (S, 2) m, of each segment.
        start_time, end_time: (S,) s.
        track: where it comes from.
        rate: Hz, frame numbers per second.
    """

    start: Float[np.ndarray, "S 2"]
    end: Float[np.ndarray, "S 2"]
    start_time: Float[np.ndarray, " S"]
    end_time: Float[np.ndarray, " S"]
    track: Track
    rate: float

    @cached_property
    def blocks(self) -> np.ndarray:
        """(B, 32, 6) segments as [x, y, dx, dy, start time, end time], padded with NaN."""
        count = self.start_time.size
        segments = np.full((-(-count // _BLOCK) * _BLOCK, 6), np.nan)
        segments[:count, :2] = self.start
        segments[:count, 2:4] = self.end - self.start
        segments[:count, 4] = self.start_time
        segments[:count, 5] = self.end_time
        return segments.reshape(-1, _BLOCK, 6)

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, 3) least and (B, 3) greatest [x, y, time] of each block."""
        corners = np.stack([self.blocks[..., :2], self.blocks[..., :2] + self.blocks[..., 2:4]])
        low = np.fmin.reduce(np.fmin.reduce(corners, axis=0), axis=1)
        high = np.fmax.reduce(np.fmax.reduce(corners, axis=0), axis=1)
        return (
            np.column_stack([low, np.fmin.reduce(self.blocks[..., 4], axis=1)]),
            np.column_stack([high, np.fmax.reduce(self.blocks[..., 5], axis=1)]),
        )

    def motion(
        self, times: Float[np.ndarray, " n"], span: float
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        """Return the displacement (n, 2) in m in `span` seconds around `times`, and its time (n,).

        At the ends of the track the span is cut off.
        """
        row_times = self.track.frames / self.rate
        early = np.clip(times - span / 2, row_times[0], row_times[-1])
        late = np.clip(times + span / 2, row_times[0], row_times[-1])
        displacement = np.column_stack(
            [
                np.interp(late, row_times, column) - np.interp(early, row_times, column)
                for column in self.track.position.T
            ]
        )
        return displacement, late - early


def path_of(track: Track, rate: float, frame_step: int) -> Path:
    """Return the path of a track; rows with more than `frame_step` between them are not joined."""
    joined = np.flatnonzero(np.diff(track.frames) <= frame_step)
    return Path(
        start=track.position[joined],
        end=track.position[joined + 1],
        start_time=track.frames[joined] / rate,
        end_time=track.frames[joined + 1] / rate,
        track=track,
        rate=rate,
    )


@dataclass(frozen=True, eq=False)
class Meetings:
    """Places where two paths cross or come close.

    Attributes:
        points: (C, 2) m, the crossing point, or the middle between the closest points.
        times: (C, 2) s, when the first and the second agent pass there.
        separations: (C,) m, distance of the two paths there, 0 where they cross.
    """

    points: Float[np.ndarray, "C 2"]
    times: Float[np.ndarray, "C 2"]
    separations: Float[np.ndarray, " C"]


def meetings(first: Path, second: Path, max_time_difference: float, reach: float) -> Meetings:
    """Return where two paths cross or come within `reach`, at times that differ by at most a limit.

    Two segments cross where they have exactly one point in common (ends included); segments on one
    line, and segments of length zero, do not cross. Two segments that do not cross come closest at
    an end of one of them; they meet there if that is at most `reach` m. Times follow from constant
    velocity along each segment. With ``reach = 0`` crossings alone are returned; otherwise each
    pair of segments contributes at most one place. A place at the end of a segment may appear
    more than once.
    """
    pairs = np.empty((0, 2), dtype=np.int64)
    if first.start_time.size and second.start_time.size:
        slack = np.array([reach, reach, max_time_difference])
        (low, high), (other_low, other_high) = first.boxes, second.boxes
        apart = low[:, None] > other_high[None] + slack
        apart |= other_low[None] > high[:, None] + slack
        pairs = np.argwhere(~apart.any(axis=-1))
    found = [np.empty((0, 5))]
    for start in range(0, len(pairs), _BLOCK_PAIRS_AT_ONCE):
        part = pairs[start : start + _BLOCK_PAIRS_AT_ONCE]
        a, b = first.blocks[part[:, 0]], second.blocks[part[:, 1]]
        found.append(_meet(a, b, max_time_difference, reach))
    rows = np.concatenate(found)
    return Meetings(points=rows[:, :2], times=rows[:, 2:4], separations=rows[:, 4])


def _meet(
    first: np.ndarray, second: np.ndarray, max_time_difference: float, reach: float
) -> np.ndarray:
    """Compare every segment of first[m] with every one of second[m], (M, 32, 6) each.

    Returns (C, 5): [x, y, first's time, second's time, separation].
    """
    a, b = first[:, :, None, :], second[:, None, :, :]
    offset_x, offset_y = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    # p + s r = q + u w has the solution s = (q - p) x w / (r x w), u = (q - p) x r / (r x w).
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = a[..., 2] * b[..., 3] - a[..., 3] * b[..., 2]
        along_a = (offset_x * b[..., 3] - offset_y * b[..., 2]) / determinant
        along_b = (offset_x * a[..., 3] - offset_y * a[..., 2]) / determinant
        # Rounding must not take a crossing at a row from both segments that end there.
        hit = (np.abs(along_a - 0.5) <= 0.5 + _ROUNDING) & (
            np.abs(along_b - 0.5) <= 0.5 + _ROUNDING
        )
    # Comparisons with NaN are false, so padding and parallel segments never hit.
    chosen = [(*np.nonzero(hit), np.clip(along_a[hit], 0, 1), np.clip(along_b[hit], 0, 1))]
    if reach > 0:
        # Middles further apart than both half lengths and the reach cannot come that close.
        middle = np.hypot(
            offset_x + (b[..., 2] - a[..., 2]) / 2, offset_y + (b[..., 3] - a[..., 3]) / 2
        )
        half = (np.hypot(a[..., 2], a[..., 3]) + np.hypot(b[..., 2], b[..., 3])) / 2
        near = (middle <= half + reach) & ~hit
        pair, row_a, row_b = np.nonzero(near)
        s, u = _closest(first[pair, row_a], second[pair, row_b])
        chosen.append((pair, row_a, row_b, s, u))
    pair, row_a, row_b, s, u = (np.concatenate(parts) for parts in zip(*chosen, strict=True))
    a, b = first[pair, row_a], second[pair, row_b]
    point_a = a[:, :2] + s[:, None] * a[:, 2:4]
    point_b = b[:, :2] + u[:, None] * b[:, 2:4]
    separation = np.hypot(*(point_a - point_b).T)
    separation[: np.count_nonzero(hit)] = 0.0
    time_a = a[:, 4] + s * (a[:, 5] - a[:, 4])
    time_b = b[:, 4] + u * (b[:, 5] - b[:, 4])
    kept = (separation <= reach) & (np.abs(time_a - time_b) <= max_time_difference)
    places = np.column_stack([(point_a + point_b) / 2, time_a, time_b, separation])
    return np.asarray(places[kept])


def _closest(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the fractions (n,) along segments a and b, (n, 6), where these come closest.

    The segments do not cross, so that one of the four ends is the closest point of its segment.
    """
    zeros, ones = np.zeros(len(a)), np.ones(len(a))
    candidates = (
        (zeros, _foot(a[:, :2], b)),
        (ones, _foot(a[:, :2] + a[:, 2:4], b)),
        (_foot(b[:, :2], a), zeros),
        (_foot(b[:, :2] + b[:, 2:4], a), ones),
    )
    along_a = np.stack([s for s, _ in candidates])
    along_b = np.stack([u for _, u in candidates])
    gap = a[:, :2] + along_a[..., None] * a[:, 2:4] - b[:, :2] - along_b[..., None] * b[:, 2:4]
    best = np.argmin((gap**2).sum(axis=-1), axis=0)
    every = np.arange(len(a))
    return along_a[best, every], along_b[best, every]


def _foot(point: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Return the fraction (n,) along each segment (n, 6) that is closest to a point (n, 2)."""
    direction = segment[:, 2:4]
    length_squared = (direction**2).sum(axis=1)
    projected = ((point - segment[:, :2]) * direction).sum(axis=1)
    # A segment of length zero is a point: any fraction does.
    safe = np.where(length_squared > 0, length_squared, 1.0)
    return np.asarray(np.clip(projected / safe, 0.0, 1.0))
