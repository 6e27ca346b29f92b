"""Routes of vehicles, learned from the earlier traffic of a recording.

Where a recording has no map, the tracks of vehicles that have left show where vehicles drive.
Tracks that run side by side are one route; how many there are is its frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
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
"""Largest difference of headings between a track and its route, rad."""
SAME_PART = 0.8
"""Of a track's points that must lie on a route for the track to follow it."""
ON_ROUTE = 2.0
"""A vehicle at most this far from a route may be on it, m."""
LEAST_POINTS = 6
"""Of a track, for a spline through its headings."""
LEAST_STEP = 0.5
"""Between points of a track that count, m: positions of standing vehicles tremble."""


class Route(NamedTuple):
    """Centre line of the tracks of vehicles that drove the same way."""

    path: Float[np.ndarray, "M 4"]
    """Points `[px, py, heading, curvature]` (m, m, rad, 1/m), `SPACING` apart."""
    frequency: float
    """Number of tracks that followed it."""


class RouteMemory:
    """Routes of a recording at any of its frames; each track is read once."""

    def __init__(self, recording: Recording) -> None:
        """Prepare the routes of a recording, from its begin."""
        vehicles = [t for t in recording.tracks if is_vehicle(t.kind)]
        self._tracks = sorted(vehicles, key=lambda t: (int(t.frames[-1]), t.agent_id))
        self._ends = np.array([int(t.frames[-1]) for t in self._tracks])
        self._found: list[tuple[Route, ...]] = [()]

    def before(self, frame: int) -> tuple[Route, ...]:
        """Return the routes of the vehicles whose tracks ended before a frame.

        Args:
            frame: Frame number; tracks that end at it or later do not count.

        Returns:
            The routes, most frequent first.
        """
        ended = int(np.searchsorted(self._ends, frame))
        while len(self._found) <= ended:
            self._found.append(_with_track(self._found[-1], self._tracks[len(self._found) - 1]))
        return self._found[ended]


def learned_routes(recording: Recording, before: int) -> tuple[Route, ...]:
    """Return the routes of the vehicles whose tracks ended before a frame, most frequent first.

    Args:
        recording: A recording, from its begin.
        before: Frame number; tracks that end at it or later do not count.

    Returns:
        The routes; `RouteMemory` serves many frames of one recording.
    """
    return RouteMemory(recording).before(before)


def _with_track(routes: tuple[Route, ...], track: Track) -> tuple[Route, ...]:
    path = _path(track)
    if path is None:
        return routes
    found = list(routes)
    for number, route in enumerate(found):
        if _follows(path, route.path):
            found[number] = Route(route.path, route.frequency + 1.0)
            break
        if _follows(route.path, path):  # the new one is longer
            found[number] = Route(path, route.frequency + 1.0)
            break
    else:
        found.append(Route(path, 1.0))
    return tuple(sorted(found, key=lambda route: -route.frequency))


def routes_at(
    routes: Sequence[Route], position: Float[np.ndarray, "2"], heading: float
) -> tuple[Route, ...]:
    """Return the routes that a vehicle at a place may be on, most frequent first.

    Args:
        routes: Of the recording.
        position: m.
        heading: rad.

    Returns:
        Those at most `ON_ROUTE` away whose heading there differs by at most `SAME_HEADING`.
    """
    place, angle = position[None], np.array([heading])
    return tuple(r for r in routes if _on(r.path, place, angle, ON_ROUTE)[0])


def ahead_of(
    route: Route, position: Float[np.ndarray, "2"], behind: float, ahead: float
) -> Float[np.ndarray, "M 4"]:
    """Return the part of a route around a place.

    Args:
        route: The route.
        position: A place near it, m.
        behind: Length of the part behind the nearest point, m.
        ahead: Length ahead of it, m.

    Returns:
        Points `[px, py, heading, curvature]` (m, m, rad, 1/m), `SPACING` apart. Past its ends the
        route continues straight.
    """
    path = route.path
    nearest = int(np.argmin(np.hypot(*(path[:, :2] - position).T)))
    along = SPACING * (np.arange(round((behind + ahead) / SPACING) + 1) + nearest) - behind
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
    kept = [0]
    for row in range(1, len(track.position)):
        if np.hypot(*(track.position[row] - track.position[kept[-1]])) >= LEAST_STEP:
            kept.append(row)
    places = track.position[kept]
    if len(kept) < LEAST_POINTS or np.hypot(*(places - places[0]).T).max() < LEAST_LENGTH:
        return None
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    count = int(along[-1] / SPACING) + 1
    even = SPACING * np.arange(count)
    points = np.stack([np.interp(even, along, c) for c in places.T], axis=1)
    chords = np.diff(points, axis=0)
    middle, heading = even[:-1] + 0.5 * SPACING, np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    spline = make_smoothing_spline(middle, heading, lam=SMOOTHING)
    return np.column_stack([points, spline(even), spline.derivative()(even)])


def _follows(path: Float[np.ndarray, "M 4"], other: Float[np.ndarray, "L 4"]) -> bool:
    """Whether most points of a path lie on another one, with its heading there."""
    on = _on(other, path[:, :2], path[:, 2], SAME_OFFSET)
    return float(np.mean(on)) >= SAME_PART


def _on(
    path: Float[np.ndarray, "L 4"],
    places: Float[np.ndarray, "M 2"],
    headings: Float[np.ndarray, "M"],
    offset: float,
) -> Bool[np.ndarray, "M"]:
    away = np.linalg.norm(path[None, :, :2] - places[:, None], axis=2)
    nearest = np.argmin(away, axis=1)
    turn = np.mod(headings - path[nearest, 2] + np.pi, 2.0 * np.pi) - np.pi
    return (away[np.arange(len(places)), nearest] <= offset) & (np.abs(turn) <= SAME_HEADING)
