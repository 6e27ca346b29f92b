"""Paths along lanes of a road network, in our axes, as the driving game takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from highway_env.road.road import RoadNetwork
from jaxtyping import Float
from scipy.interpolate import make_lsq_spline

from foresight_env.highway.axes import flipped_places

LaneIndex = tuple[str, str, int]
FINER = 1.0
"""Distance between points of routes that predictors get, m."""
SPACING = 2.0
"""Between the points of a path, m."""
POINTS = 90
"""Of a path: 178 m."""
FINE = 0.5
"""Between the places that lanes are sampled at, m."""
KNOTS = 4.0
"""Between the knots of the spline through them, m."""


class Leg(NamedTuple):
    """A part of a lane."""

    lane: LaneIndex
    begin: float = 0.0
    """m from the lane's start."""
    end: float | None = None
    """None: to the lane's end."""


def path_along(network: RoadNetwork, legs: Sequence[Leg]) -> Float[np.ndarray, "M 4"]:
    """Points `[px, py, heading, curvature]` along the middle of lanes, then straight on.

    Where a leg does not begin where the one before ends, a cubic joins them: a lane change.
    """
    places = flipped_places(_places(network, legs))
    length = SPACING * (POINTS - 1)
    ahead = places[-1] - places[-2]
    beyond = np.arange(1, int(length / FINE) + 2)[:, None] * FINE * ahead / np.hypot(*ahead)
    places = np.concatenate([places, places[-1] + beyond])
    steps = np.hypot(*np.diff(places, axis=0).T)
    kept = np.concatenate([[True], steps > 1e-6])
    places = places[kept]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    inner = np.arange(KNOTS, along[-1] - KNOTS, KNOTS)
    knots = np.concatenate([[along[0]] * 4, inner, [along[-1]] * 4])
    spline = make_lsq_spline(along, places, knots)
    at = SPACING * np.arange(POINTS)
    first, second = spline(at, 1), spline(at, 2)
    speed = np.hypot(*first.T)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    return np.column_stack([spline(at), heading, curvature])


def _places(network: RoadNetwork, legs: Sequence[Leg]) -> Float[np.ndarray, "K 2"]:
    parts: list[np.ndarray] = []
    for leg in legs:
        lane = network.get_lane(leg.lane)
        end = lane.length if leg.end is None else leg.end
        at = np.append(np.arange(leg.begin, end, FINE), end)
        sampled = np.array([lane.position(s, 0.0) for s in at])
        if parts:
            parts.append(_join(parts[-1], sampled))
        parts.append(sampled)
    return np.concatenate(parts)


def _join(
    before: Float[np.ndarray, "K 2"], after: Float[np.ndarray, "L 2"]
) -> Float[np.ndarray, "J 2"]:
    """A cubic Hermite curve from the end of one part to the start of the next."""
    gap = float(np.hypot(*(after[0] - before[-1])))
    if gap < FINE:
        return np.zeros((0, 2))
    leave, arrive = before[-1] - before[-2], after[1] - after[0]
    leave, arrive = (gap * v / np.hypot(*v) for v in (leave, arrive))
    t = np.linspace(0.0, 1.0, max(int(gap / FINE), 2) + 1)[1:-1, None]
    basis = 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2
    return np.asarray(
        basis[0] * before[-1] + basis[1] * leave + basis[2] * after[0] + basis[3] * arrive
    )


def finer(path: Float[np.ndarray, "M 4"]) -> Float[np.ndarray, "L 4"]:
    """Return a path with points `FINER` apart instead of `SPACING`, by linear interpolation.

    Args:
        path: (M, 4) `[px, py, heading, curvature]`, headings without jumps.
    """
    at = SPACING * np.arange(len(path))
    along = np.arange(0.0, at[-1] + 0.5 * FINER, FINER)
    return np.stack([np.interp(along, at, column) for column in path.T], axis=1)
