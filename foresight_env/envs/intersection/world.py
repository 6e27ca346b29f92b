"""The junction as an environment sees it."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from foresight_env.envs.core.scene import Population
from foresight_env.envs.core.world import World
from foresight_env.envs.rendering.scenery import ASPHALT, PAVEMENT, STRIPE, Disc, Polygon, Scenery
from foresight_env.games.footprints import Footprint, Motion, least_gaps
from foresight_env.games.kinds import CAR, body_radius, is_vehicle
from foresight_env.games.roads import Point, RoadBoundary
from foresight_env.precision import in_double_precision
from foresight_env.scenarios.intersection import PEDESTRIAN_SHRINK
from foresight_env.scenarios.junction import (
    JUNCTION_REGION,
    JunctionRanges,
    draw_junction,
    junction_game,
    junction_kinds,
    junction_routes,
)

WALKING_GOAL_RADIUS, DRIVING_GOAL_RADIUS = 1.0, 3.0
"""m; cars drive on, and must only have come by."""
SHOWN_LOW, SHOWN_HIGH = (-80.0, 0.0), (50.0, 150.0)
"""Range of positions that observations show, m."""
SHOWN_WALKING = 6.0
"""Largest velocity of a pedestrian that an observation can show, m/s."""
SHOWN_SPEED, SHOWN_HEADING = 25.0, 4.0 * np.pi
"""Largest speed (m/s) and heading (rad, not wrapped) of a car that an observation can show."""
FAR = 200.0
"""End of drawn roads, m."""
CROSSING = ((-19.6, 58.8), (-17.6, 67.6))
"""Middle of the marked crossing over the western arm, m."""
CROSSING_WIDTH = 3.0
STRIPE_PART = 0.055
"""Of the crossing's length."""
OFF_ROAD = 0.1
"""Beyond the region's edge by more than this is off the road, m."""


def intersection_world(pedestrians: int, cars: int, ranges: JunctionRanges) -> World:
    """Pedestrians, who never hurt each other, and cars, with their footprints."""
    kinds = junction_kinds(pedestrians, cars)
    walks = np.array([not is_vehicle(kind) for kind in kinds])
    footprints = tuple(
        Footprint(radius=body_radius(kind)) if walking else Footprint(CAR.length, CAR.width)
        for kind, walking in zip(kinds, walks, strict=True)
    )
    walking = np.array([SHOWN_WALKING, SHOWN_WALKING])
    driving = np.array([SHOWN_SPEED, SHOWN_HEADING])
    spread = np.where(walks[:, None], walking, driving)

    def gaps(
        before: Float[np.ndarray, "N n"],
        controls: Float[np.ndarray, "N m"],
        after: Float[np.ndarray, "N n"],
    ) -> Float[np.ndarray, "N N"]:
        moves = [
            Motion(a[:2], b[:2], 0.0, 0.0)
            if walking
            else Motion(a[:2], b[:2], float(a[3]), float(b[3] - a[3]))
            for walking, a, b in zip(walks, before, after, strict=True)
        ]
        return least_gaps(footprints, moves, lambda i, j: not (walks[i] and walks[j]))

    return World(
        names=tuple(f"{kind}_{i}" for i, kind in enumerate(kinds)),
        game=lambda horizon: junction_game(pedestrians, cars, horizon),
        draw=lambda random: draw_junction(random, pedestrians, cars, ranges),
        gaps=gaps,
        shown_low=np.concatenate([np.tile(SHOWN_LOW, (len(kinds), 1)), -spread], axis=1),
        shown_high=np.concatenate([np.tile(SHOWN_HIGH, (len(kinds), 1)), spread], axis=1),
        goal_radius=np.where(walks, WALKING_GOAL_RADIUS, DRIVING_GOAL_RADIUS),
        footprints=footprints,
        scenery=_scenery(),
        population=_population(pedestrians, cars, ranges),
        routes=junction_routes(cars),
        off_road=lambda states: off_road(states, walks),
    )


def _population(pedestrians: int, cars: int, ranges: JunctionRanges) -> Population:
    usual = draw_junction(np.random.default_rng(0), pedestrians, cars, ranges._replace(goal=0.0))
    return Population.drawn_uniformly(usual.theta, "goal", ranges.goal, ranges.gamma)


def off_road(
    states: Float[np.ndarray, "N n"], walks: Bool[np.ndarray, "N"]
) -> Bool[np.ndarray, "N"]:
    """Agents that violate, by more than `OFF_ROAD`, the region that the game forbids to leave."""
    places = states[:, :2]
    centers = np.array([corner.center for corner in JUNCTION_REGION.corners])
    radii = np.array([corner.radius for corner in JUNCTION_REGION.corners])
    distances = np.linalg.norm(places[:, None] - centers, axis=2)
    shrink = np.where(walks, PEDESTRIAN_SHRINK, 1.0)[:, None]
    inside = (distances < shrink * radii - OFF_ROAD).any(axis=1)
    beside = (np.asarray(_beside_roads(places)) < -OFF_ROAD).any(axis=1)
    return inside | (beside & ~walks)


@in_double_precision
@jax.jit
def _beside_roads(places: Float[Array, "N 2"]) -> Float[Array, "N sides"]:
    beside = RoadBoundary(JUNCTION_REGION.sides)
    return jax.vmap(lambda place: beside(0, 1, (place,), (), {}))(places)


def _scenery() -> Scenery:
    """Asphalt between the road sides and corners, and stripes where people cross."""
    sides = JUNCTION_REGION.sides
    centre = np.mean([side.start for side in sides], axis=0)
    around = sorted(sides, key=lambda side: np.arctan2(*(np.array(side.start) - centre)[::-1]))
    outline: list[Point] = []
    for side in around:
        start, end = np.array(side.start), np.array(side.end)
        far = start + FAR * (end - start) / np.linalg.norm(end - start)
        reach = (side.start, (float(far[0]), float(far[1])))
        # Seen counter-clockwise, a road on the left is one whose side is its right edge.
        outline += reach if side.road == "left" else reach[::-1]
    corners = (Disc(corner.center, corner.radius, PAVEMENT) for corner in JUNCTION_REGION.corners)
    stripes = (_stripe(k) for k in np.arange(0.05, 1.0, 2.0 * STRIPE_PART))
    shapes: tuple[Polygon | Disc, ...] = (Polygon(tuple(outline), ASPHALT), *corners, *stripes)
    return Scenery("intersection", (-14.0, 68.0), 24.0, shapes)


def _stripe(start: float) -> Polygon:
    low, high = np.array(CROSSING)
    along = high - low
    side = 0.5 * CROSSING_WIDTH * np.array([along[1], -along[0]]) / np.linalg.norm(along)
    ends = low + start * along, low + (start + STRIPE_PART) * along
    corners = ends[0] - side, ends[0] + side, ends[1] + side, ends[1] - side
    return Polygon(tuple((float(x), float(y)) for x, y in corners), STRIPE)
