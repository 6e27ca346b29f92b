"""Footprints of agents, boxes with rounded corners and discs, and the gaps between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

RESOLUTION = 0.01
"""The smallest gap during a step is known to within this, m."""
MOST_SPANS = 64
"""That a step is first cut into; those that may hold the smallest gap are cut again."""


@dataclass(frozen=True)
class Footprint:
    """A box around the agent's position, along its heading, with a border of `radius`; metres."""

    length: float = 0.0
    width: float = 0.0
    radius: float = 0.0

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the position, m."""
        return float(np.hypot(self.length, self.width)) / 2.0 + self.radius


class Motion(NamedTuple):
    """How an agent moves during one step: its position evenly along a line, its heading evenly."""

    start: Float[np.ndarray, "2"]
    end: Float[np.ndarray, "2"]
    heading: float
    """rad."""
    turn: float
    """Change of the heading during the step, rad."""


def gap(
    first: Footprint,
    second: Footprint,
    relative: Float[np.ndarray, "K 2"],
    heading: Float[np.ndarray, "K"],
    other_heading: Float[np.ndarray, "K"],
) -> Float[np.ndarray, "K"]:
    """Distance (m) between footprints, `relative` from the first's position to the second's.

    Negative where they overlap: the least distance by which one must be moved to part them. The set
    of all differences of points is a zonotope, and the origin's distance to it is the gap.
    """
    sides = [
        (0.5 * size, angle + quarter)
        for shape, angle in ((first, heading), (second, other_heading))
        for size, quarter in ((shape.length, 0.0), (shape.width, 0.5 * np.pi))
        if size > 0.0
    ]
    borders = first.radius + second.radius
    if not sides:
        away: Float[np.ndarray, "K"] = np.linalg.norm(relative, axis=1)
        return away - borders
    sizes = np.array([size for size, _ in sides])
    angles = np.stack([angle for _, angle in sides], axis=1)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    edges, normals = sizes[:, None] * along, np.stack([-along[..., 1], along[..., 0]], axis=2)
    rest, signs = _others(len(sides))
    # (K, edge, sign): middles of all edges; those inside the zonotope are never nearest.
    middles = relative[:, None, None] + signs @ edges[:, rest]
    beside = np.sum(middles * along[:, :, None], axis=3)
    excess = np.maximum(np.abs(beside) - sizes[:, None], 0.0)
    across = np.sum(middles * normals[:, :, None], axis=3)
    outside = np.sqrt((excess**2 + across**2).min(axis=(1, 2)))
    support = np.abs(np.sum(normals[:, :, None] * edges[:, rest], axis=3)).sum(axis=2)
    inside = (np.abs(np.sum(normals * relative[:, None], axis=2)) - support).max(axis=1)
    return np.where(inside < 0.0, inside, outside) - borders


@lru_cache
def _others(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Per edge the indices of the others (count, count - 1), and all their signs."""
    rest = np.array([[j for j in range(count) if j != k] for k in range(count)], dtype=int)
    signs = np.array(list(product((-1.0, 1.0), repeat=count - 1)), dtype=float)
    return rest, signs


def least_gap(first: Footprint, second: Footprint, motion: Motion, other: Motion) -> float:
    """Smallest gap (m) between two footprints during a step, to within `RESOLUTION`."""
    step = (other.end - other.start) - (motion.end - motion.start)
    # The gap changes by no more than this during the step.
    way = np.hypot(*step) + abs(motion.turn) * first.reach + abs(other.turn) * second.reach

    def at(moments: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
        relative = (other.start - motion.start) + moments[:, None] * step
        headings = motion.heading + moments * motion.turn
        return gap(first, second, relative, headings, other.heading + moments * other.turn)

    # Spans short enough that nothing in between can be missed, unless there were too many.
    count = int(np.clip(np.ceil(0.5 * way / RESOLUTION), 1, MOST_SPANS))
    moments = np.linspace(0.0, 1.0, count + 1)
    gaps = at(moments)
    while True:
        best = float(gaps.min())
        spans = np.diff(moments)
        least = 0.5 * (gaps[:-1] + gaps[1:] - way * spans)
        unsure = np.flatnonzero(least < best - RESOLUTION)
        if unsure.size == 0:
            return best
        middles = moments[unsure] + 0.5 * spans[unsure]
        moments = np.insert(moments, unsure + 1, middles)
        gaps = np.insert(gaps, unsure + 1, at(middles))


def least_gaps(
    footprints: Sequence[Footprint],
    motions: Sequence[Motion],
    counted: Callable[[int, int], bool] = lambda i, j: True,
) -> Float[np.ndarray, "N N"]:
    """Smallest gaps (m) during a step between all pairs that are `counted`; infinite for others.

    A pair that is certainly farther apart than both agents are from a third has a lower bound
    of its gap: what is nearest to each agent is exact.
    """
    count = len(motions)
    found = np.full((count, count), np.inf)
    start = np.stack([m.start for m in motions])
    reach = np.array([shape.reach for shape in footprints])
    moved = np.array([np.hypot(*(m.end - m.start)) for m in motions])
    bound = (
        np.linalg.norm(start[:, None] - start, axis=2) - (reach + moved) - (reach + moved)[:, None]
    )
    pairs = [(i, j) for i in range(count) for j in range(i) if counted(i, j)]
    for i, j in sorted(pairs, key=lambda pair: bound[pair]):
        best = max(found[i].min(), found[j].min())
        if bound[i, j] > best:
            found[i, j] = found[j, i] = bound[i, j]
            continue
        found[i, j] = found[j, i] = least_gap(footprints[i], footprints[j], motions[i], motions[j])
    return found
