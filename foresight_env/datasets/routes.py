"""Routes of vehicles, learned from the earlier traffic of a recording.

Where a recording has no map, the tracks of vehicles that have left show where vehicles drive.
Tracks that run side by side are one route; how many there are is its frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline

from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track
from foresight_env.games.kinds import is_vehicle

SPACING = 1.0
"""Of a route's points, m."""
LEAST_LENGTH = 8.0
"""A track that is shorter shows no route, m."""
SMOOTHING = 3.0
"""Of headings along a track (`scipy.interpolate.make_smoothing_spline`), m^3: recorded headings
tremble by a few degrees, curvatures of roads change over metres."""
SAME_OFFSET = 1.5
"""Tracks at most this far from a route follow it, m: half a lane."""
SAME_HEADING = np.radians(25.0)
"""And head where it leads, to this angle, rad."""
SAME_PART = 0.8
"""Of a track's points that must lie on a route for the track to follow it."""
ON_ROUTE = 2.0
"""A vehicle at most this far from a route may be on it, m."""
BEYOND = 40.0
"""Length by which routes go straight on beyond their last point, m: traffic leaves the picture."""


class Route(NamedTuple):
    """A way that vehicles take."""

    path: Float[np.ndarray, "M 4"]
    """Points `[px, py, heading, curvature]` (m, m, rad, 1/m), `SPACING` apart."""
    frequency: int
    """Tracks that followed it."""


def learned_routes(recording: Recording, before: int) -> tuple[Route, ...]:
    """Return the routes of the vehicles whose tracks ended before a frame, most frequent first.

    Args:
        recording: A recording, from its begin.
        before: Frame number; tracks that end at it or later do not count.
    """
    found: list[Route] = []
    ended = [t for t in recording.tracks if is_vehicle(t.kind) and int(t.frames[-1]) < before]
    for track in sorted(ended, key=lambda t: (int(t.frames[-1]), t.agent_id)):
        path = _path(track)
        if path is None:
            continue
        for number, route in enumerate(found):
            if _follows(path, route.path):
                found[number] = Route(route.path, route.frequency + 1)
                break
            if _follows(route.path, path):  # the new one is longer
                found[number] = Route(path, route.frequency + 1)
                break
        else:
            found.append(Route(path, 1))
    return tuple(sorted(found, key=lambda route: -route.frequency))


def routes_at(
    routes: Sequence[Route], position: Float[np.ndarray, "2"], heading: float
) -> tuple[Route, ...]:
    """Return the routes that a vehicle at a place may be on, most frequent first.

    Args:
        routes: Of the recording.
        position: m.
        heading: rad.
    """
    return tuple(r for r in routes if _on(r.path, position, heading, ON_ROUTE))


def ahead_of(
    route: Route, position: Float[np.ndarray, "2"], behind: float, length: float
) -> Float[np.ndarray, "M 4"]:
    """Return the part of a route from `behind` metres behind a place, `length` metres long.

    Beyond its last point the route goes straight on, before its first straight back.
    """
    path = route.path
    nearest = int(np.argmin(np.hypot(*(path[:, :2] - position).T)))
    along = SPACING * (np.arange(round((behind + length) / SPACING) + 1) + nearest) - behind
    inside = np.clip(along / SPACING, 0, len(path) - 1)
    low = np.minimum(inside.astype(int), len(path) - 2)
    part = (inside - low)[:, None]
    points = (1.0 - part) * path[low] + part * path[low + 1]
    over = along - SPACING * inside
    points[:, 0] += over * np.cos(points[:, 2])
    points[:, 1] += over * np.sin(points[:, 2])
    points[:, 3] = np.where(over == 0.0, points[:, 3], 0.0)
    return np.asarray(points)


def _path(track: Track) -> Float[np.ndarray, "M 4"] | None:
    """A track's points at even distances with heading and curvature; None where it is short."""
    steps = np.hypot(*np.diff(track.position, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    moving = np.concatenate([[True], np.diff(along) > 1e-3])
    along, places = along[moving], track.position[moving]
    count = int(along[-1] / SPACING) + 1
    if along[-1] < LEAST_LENGTH or len(along) < 6:
        return None
    even = SPACING * np.arange(count)
    points = np.stack([np.interp(even, along, c) for c in places.T], axis=1)
    chords = np.diff(points, axis=0)
    middle, heading = even[:-1] + 0.5 * SPACING, np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    spline = make_smoothing_spline(middle, heading, lam=SMOOTHING)
    return np.column_stack([points, spline(even), spline.derivative()(even)])


def _follows(path: Float[np.ndarray, "M 4"], other: Float[np.ndarray, "L 4"]) -> bool:
    """Whether most points of a path lie on another one and head where it leads."""
    on = [_on(other, point[:2], float(point[2]), SAME_OFFSET) for point in path]
    return float(np.mean(on)) >= SAME_PART


def _on(
    path: Float[np.ndarray, "M 4"], position: Float[np.ndarray, "2"], heading: float, offset: float
) -> bool:
    away = np.hypot(*(path[:, :2] - position).T)
    nearest = int(np.argmin(away))
    turn = float(np.mod(heading - path[nearest, 2] + np.pi, 2.0 * np.pi) - np.pi)
    return bool(away[nearest] <= offset and abs(turn) <= SAME_HEADING)
