"""The crosswalk as an environment sees it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from foresight_env.envs.core.scene import Population
from foresight_env.envs.core.world import World
from foresight_env.envs.rendering.scenery import ASPHALT, STRIPE, Scenery, rectangle
from foresight_env.games.footprints import Footprint
from foresight_env.scenarios.crosswalk import (
    COLLISION_DISTANCE,
    DT,
    Proximity,
    Ranges,
    crosswalk_game,
    draw_crossing,
)

GOAL_RADIUS = 0.25
POSITION_LIMIT = 20.0
"""Largest coordinate that an observation can show, m."""
VELOCITY_LIMIT = 5.0
"""Largest velocity that an observation can show, m/s: noise goes beyond the speed limit."""
_FAR = 100.0
_ROAD = (0.1, 1.9)
"""Edges of the road along y, m."""
_CROSSWALK = (-0.5, 2.5)
"""Edges of the marked crossing along x, m."""
_STRIPE_WIDTH = 0.2
SCENERY = Scenery(
    "crosswalk",
    (1.0, 1.0),
    1.75,
    (
        rectangle((-_FAR, _ROAD[0]), (_FAR, _ROAD[1]), ASPHALT),
        *(
            rectangle((_CROSSWALK[0], low), (_CROSSWALK[1], low + _STRIPE_WIDTH), STRIPE)
            for low in np.arange(_ROAD[0], _ROAD[1] - 0.01, 2.0 * _STRIPE_WIDTH)
        ),
    ),
)


def crosswalk_world(players: int, proximity: Proximity, ranges: Ranges) -> World:
    """`players` pedestrians, discs of half the collision distance."""
    shown = np.tile([POSITION_LIMIT] * 2 + [VELOCITY_LIMIT] * 2, (players, 1))
    return World(
        names=tuple(f"pedestrian_{i}" for i in range(players)),
        game=lambda horizon: crosswalk_game(players, horizon, proximity),
        draw=lambda random: draw_crossing(random, players, ranges),
        gaps=lambda before, controls, after: (
            closest_approach(before, controls, after) - COLLISION_DISTANCE
        ),
        shown_low=-shown,
        shown_high=shown,
        goal_radius=np.full(players, GOAL_RADIUS),
        footprints=(Footprint(radius=0.5 * COLLISION_DISTANCE),) * players,
        scenery=SCENERY,
        population=_population(players, ranges),
    )


def _population(players: int, ranges: Ranges) -> Population:
    usual = draw_crossing(np.random.default_rng(0), players, ranges._replace(goal=0.0))
    return Population.drawn_uniformly(usual.theta, "goal", ranges.goal, ranges.gamma)


def closest_approach(
    before: Float[np.ndarray, "N 4"],
    controls: Float[np.ndarray, "N 2"],
    after: Float[np.ndarray, "N 4"],
    dt: float = DT,
) -> Float[np.ndarray, "N N"]:
    """Smallest distance (m) between the centres of each pair during a step; infinite diagonal.

    Exact for double integrators: the relative position is a quadratic in time, so its squared
    length is least at an end of the step or where a cubic is zero.
    """
    count = len(before)
    bends = 0.5 * dt**2 * controls
    slopes = after[:, :2] - before[:, :2] - bends
    distances = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i):
            # Relative position as a polynomial in the fraction of the step that has passed.
            relative = np.stack(
                [
                    before[i, :2] - before[j, :2],
                    slopes[i] - slopes[j],
                    bends[i] - bends[j],
                ]
            )
            distances[i, j] = distances[j, i] = _least_length(relative)
    return distances


def _least_length(curve: Float[np.ndarray, "3 2"]) -> float:
    """Least length of `curve[0] + curve[1] s + curve[2] s^2` over s in [0, 1]."""
    start, slope, bend = curve
    # Half the derivative of the squared length, highest power first.
    cubic = np.array(
        [
            2.0 * bend @ bend,
            3.0 * slope @ bend,
            slope @ slope + 2.0 * start @ bend,
            start @ slope,
        ]
    )
    # Coefficients that are rounding relative to the others would make the roots overflow.
    cubic[np.abs(cubic) < 1e-14 * np.max(np.abs(cubic))] = 0.0
    roots = np.roots(cubic).real
    # A complex root's real part is one more harmless sample.
    moments = np.clip(np.concatenate([[0.0, 1.0], roots]), 0.0, 1.0)[:, None]
    return float(np.min(np.linalg.norm(start + moments * (slope + moments * bend), axis=1)))
