"""A driving scene as an environment sees it."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane, LineType
from jaxtyping import Bool, Float

from foresight_env.envs.core.scene import OpponentPrior, Population
from foresight_env.envs.core.world import World
from foresight_env.envs.rendering.scenery import ASPHALT, STRIPE, Polygon, Scenery
from foresight_env.games.footprints import Footprint, Motion, least_gaps
from foresight_env.games.kinds import SIMULATED_CAR
from foresight_env.highway.axes import flipped_places
from foresight_env.highway.likely_route import likely_paths
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.routes import finer
from foresight_env.highway.scenes import DrivingScene, draw_driving
from foresight_env.scenarios.driving import SPEED_LIMIT, driving_game

GOAL_RADIUS = 4.0
"""Cars drive on, and must only have come by, m."""
SHOWN = 600.0
"""Largest coordinate that an observation can show, m; the same in all scenes, so that they stand
side by side in a vector environment."""
SHOWN_HEADING = 4.0 * np.pi
"""rad; headings are not wrapped."""
OFF_ROAD = 1.0
"""A car whose middle is farther outside every lane than this is off the road, m."""
SAMPLES = 1.0
"""Between the places of lanes that are looked at, m."""
LINE_WIDTH = 0.2
STRIPE_LENGTH, STRIPE_PERIOD = 3.0, 8.0
"""Of broken lines, m."""


def driving_world(
    scene: DrivingScene, cars: int, ranges: DrivingRanges, dt: float, substeps: int
) -> World:
    """The cars of a scene with their boxes."""
    footprints = (Footprint(SIMULATED_CAR.length, SIMULATED_CAR.width),) * cars
    low = np.array([-SHOWN, -SHOWN, -1.0, -SHOWN_HEADING])
    high = np.array([SHOWN, SHOWN, SPEED_LIMIT + 5.0, SHOWN_HEADING])

    def gaps(
        before: Float[np.ndarray, "N n"],
        controls: Float[np.ndarray, "N m"],
        after: Float[np.ndarray, "N n"],
    ) -> Float[np.ndarray, "N N"]:
        moves = [
            Motion(a[:2], b[:2], float(a[3]), float(b[3] - a[3]))
            for a, b in zip(before, after, strict=True)
        ]
        return least_gaps(footprints, moves)

    return World(
        names=tuple(f"car_{i}" for i in range(cars)),
        game=lambda horizon: driving_game(cars, horizon, dt, substeps),
        draw=lambda random: draw_driving(random, scene, cars, ranges),
        gaps=gaps,
        shown_low=np.tile(low, (cars, 1)),
        shown_high=np.tile(high, (cars, 1)),
        goal_radius=np.full(cars, GOAL_RADIUS),
        footprints=footprints,
        scenery=_scenery(scene),
        opponent_prior=OpponentPrior(
            ("target_speed",),
            (("target_speed", 2.0),),
            partial(_on_possible_ways, scene),
        ),
        population=_population(scene, cars, ranges),
        routes=tuple(finer(path) for path in scene.paths),
        off_road=lambda states: off_road(scene, states),
    )


def _population(scene: DrivingScene, cars: int, ranges: DrivingRanges) -> Population:
    usual = draw_driving(np.random.default_rng(0), scene, cars, ranges._replace(speed=0.0))
    return Population.drawn_uniformly(usual.theta, "target_speed", ranges.speed, ranges.gamma)


def _on_possible_ways(
    scene: DrivingScene,
    own: dict[str, Any],
    track: Float[np.ndarray, "K 2"],
    state: Float[np.ndarray, "4"],
) -> tuple[dict[str, Any], ...]:
    """The ego's weights, the present speed, and each path along the roads that fits the track."""
    return tuple(
        {**own, "path": path, "goal": path[-1, :2], "target_speed": float(state[2])}
        for path in likely_paths(scene, track, float(state[3]))
    )


@lru_cache
def _lane_places(scene: DrivingScene) -> tuple[np.ndarray, np.ndarray]:
    """Places (K, 2) along the middle of all lanes, in our axes, and half widths (K,), m."""
    places, halves = [], []
    for lane in scene.network.lanes_list():
        at = np.append(np.arange(0.0, lane.length, SAMPLES), lane.length)
        places += [lane.position(s, 0.0) for s in at]
        halves += [0.5 * lane.width_at(s) for s in at]
    return flipped_places(np.array(places)), np.array(halves)


def off_road(scene: DrivingScene, states: Float[np.ndarray, "N n"]) -> Bool[np.ndarray, "N"]:
    """Whose middle is outside every lane by more than `OFF_ROAD`."""
    places, halves = _lane_places(scene)
    away = np.linalg.norm(states[:, None, :2] - places, axis=2) - halves
    return np.asarray(away.min(axis=1) > OFF_ROAD)


@lru_cache
def _scenery(scene: DrivingScene) -> Scenery:
    """Lanes as asphalt, and the lines between them."""
    lanes = scene.network.lanes_list()
    asphalt = [_band(lane, 0.0, lane.width_at(0.0), 0.0, lane.length, ASPHALT) for lane in lanes]
    lines: list[Polygon] = []
    for lane in lanes:
        half = 0.5 * lane.width_at(0.0)
        for kind, side in zip(lane.line_types, (-half, half), strict=True):
            if kind in (LineType.CONTINUOUS, LineType.CONTINUOUS_LINE):
                lines.append(_band(lane, side, LINE_WIDTH, 0.0, lane.length, STRIPE))
            elif kind == LineType.STRIPED:
                lines += [
                    _band(lane, side, LINE_WIDTH, s, min(s + STRIPE_LENGTH, lane.length), STRIPE)
                    for s in np.arange(0.0, lane.length, STRIPE_PERIOD)
                ]
    return Scenery(scene.name.replace("_", " "), scene.center, scene.half_width, (*asphalt, *lines))


def _band(
    lane: AbstractLane,
    offset: float,
    width: float,
    begin: float,
    end: float,
    colour: tuple[int, int, int],
) -> Polygon:
    """A strip along a lane, `offset` from its middle."""
    at = np.linspace(begin, end, max(int((end - begin) / 2.0), 1) + 1)
    edges = [[lane.position(s, offset + side) for s in at] for side in (-0.5 * width, 0.5 * width)]
    corners = flipped_places(np.array([*edges[0], *edges[1][::-1]]))
    return Polygon(tuple((float(x), float(y)) for x, y in corners), colour)
