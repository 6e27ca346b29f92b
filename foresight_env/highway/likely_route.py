"""Likely routes of a car, from its recent track and the roads."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from foresight_env.highway.axes import flipped_places
from foresight_env.highway.routes import POINTS, SPACING, LaneIndex, Leg, path_along
from foresight_env.highway.scenes import DrivingScene

BESIDE = 2.5
"""Distance from a lane's middle above which a car is not on it, m."""
SLACK = 3.0
"""Beyond a lane's ends it is still on it for so long, m."""
ROUTE = 150.0
"""Length of a route, m."""
STRAIGHTNESS = 0.05
"""Price of turning by a radian, in m^2 of mean squared offset: where nothing speaks for a turn, the
straightest way is the likely one."""

BEHIND = 15.0
"""How much of its lane behind the car a path has at least, m."""
GRID = 10.0
"""Paths begin at multiples of this along a lane, m, so that there are few to be remembered."""


POSSIBLE = 0.5
"""Mean squared offset (m^2) by which a path may fit worse than the best and still be possible."""
SAME = 1.0
"""Paths that stay within this over the next `LOOK_AHEAD` points count as one, m."""


def likely_paths(
    scene: DrivingScene, track: Float[np.ndarray, "K 2"], heading: float
) -> tuple[Float[np.ndarray, "M 4"], ...]:
    """Paths along lanes that fit a car's observed positions, the best first.

    Args:
        scene: whose roads are known.
        track: (K, 2) positions, the newest last, m; none missing.
        heading: present heading, rad; NaN where it is not known.

    Returns:
        Points `[px, py, heading, curvature]` of each path; straight on where the car is on no lane.
    """
    candidates = [
        _path(scene, lanes, begin)
        for start, begin in _lanes_at(scene, track[0])
        for lanes in _routes(scene, start)
    ]
    scored = [(_misfit(path, track, heading), k) for k, path in enumerate(candidates)]
    if not scored or min(scored)[0] > BESIDE**2:
        return (_straight_on(track, heading),)
    found: list[np.ndarray] = []
    ahead: list[np.ndarray] = []
    for misfit, k in sorted(scored):
        if misfit > min(scored)[0] + POSSIBLE:
            break
        path = candidates[k]
        nearest = int(np.argmin(np.sum((path[:, :2] - track[-1]) ** 2, axis=1)))
        next_points = path[nearest : nearest + LOOK_AHEAD, :2]
        if all(_apart(next_points, other) > SAME for other in ahead):
            found.append(path)
            ahead.append(next_points)
    return tuple(found)


def likely_path(
    scene: DrivingScene, track: Float[np.ndarray, "K 2"], heading: float
) -> Float[np.ndarray, "M 4"]:
    """Return the best of `likely_paths`."""
    return likely_paths(scene, track, heading)[0]


def _apart(points: Float[np.ndarray, "K 2"], others: Float[np.ndarray, "L 2"]) -> float:
    """Largest distance (m) of a point from the nearest of the others."""
    away = np.linalg.norm(points[:, None] - others, axis=2)
    return float(away.min(axis=1).max())


def _lanes_at(
    scene: DrivingScene, place: Float[np.ndarray, "2"]
) -> Iterator[tuple[LaneIndex, float]]:
    """Lanes that the place is on, and where on them a path from a little behind it begins, m."""
    there = flipped_places(place)
    for index, lane in scene.network.lanes_dict().items():
        along, beside = lane.local_coordinates(there)
        if abs(beside) <= BESIDE and -SLACK <= along <= lane.length + SLACK:
            yield index, max(0.0, GRID * np.floor((along - BEHIND) / GRID))


def _routes(scene: DrivingScene, start: LaneIndex) -> Iterator[tuple[LaneIndex, ...]]:
    """All sequences of lanes from `start` on, until they are long enough or end."""
    graph = scene.network.graph
    waiting: list[tuple[tuple[LaneIndex, ...], float]] = [
        ((start,), scene.network.get_lane(start).length)
    ]
    while waiting:
        lanes, length = waiting.pop()
        _, node, number = lanes[-1]
        following = [
            (node, to, min(number, len(several) - 1)) for to, several in graph.get(node, {}).items()
        ]
        if not following or length > ROUTE:
            yield lanes
            continue
        for lane in following:
            waiting.append(((*lanes, lane), length + scene.network.get_lane(lane).length))


@lru_cache(maxsize=512)
def _path(
    scene: DrivingScene, lanes: tuple[LaneIndex, ...], begin: float
) -> Float[np.ndarray, "M 4"]:
    first, *rest = lanes
    path = path_along(scene.network, [Leg(first, begin), *(Leg(lane) for lane in rest)])
    path.flags.writeable = False
    return path


def _misfit(
    path: Float[np.ndarray, "M 4"], track: Float[np.ndarray, "K 2"], heading: float
) -> float:
    """Mean squared offset (m^2), a heading that differs, and the turning that is still to come."""
    away = track[:, None] - path[:, :2]
    nearest = np.argmin(np.sum(away**2, axis=2), axis=1)
    foot = path[nearest]
    offset = np.cos(foot[:, 2]) * (track[:, 1] - foot[:, 1]) - np.sin(foot[:, 2]) * (
        track[:, 0] - foot[:, 0]
    )
    along = np.cos(foot[:, 2]) * (track[:, 0] - foot[:, 0]) + np.sin(foot[:, 2]) * (
        track[:, 1] - foot[:, 1]
    )
    beyond = np.maximum(np.abs(along) - 1.5, 0.0)
    cost = float(np.mean(offset**2 + beyond**2))
    if not np.isnan(heading):
        askew = np.mod(heading - foot[-1, 2] + np.pi, 2.0 * np.pi) - np.pi
        cost += float(2.0 * askew**2)
    ahead = path[nearest[-1] : nearest[-1] + LOOK_AHEAD, 2]
    return cost + STRAIGHTNESS * float(np.abs(np.diff(ahead)).sum())


LOOK_AHEAD = 20
"""Points of a path whose turning counts."""


def _straight_on(track: Float[np.ndarray, "K 2"], heading: float) -> Float[np.ndarray, "M 4"]:
    """Along the heading, or along the track where that is not known."""
    if np.isnan(heading):
        way = track[-1] - track[0]
        heading = float(np.arctan2(way[1], way[0]))
    aim = np.array([np.cos(heading), np.sin(heading)])
    places = track[0] + SPACING * np.arange(POINTS)[:, None] * aim
    return np.column_stack([places, np.full(POINTS, heading), np.zeros(POINTS)])
