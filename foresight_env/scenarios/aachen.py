"""The published intersection: Aachen, location 1 of the inD recordings (paper, section VI-B).

Positions are the recording's turned by `AACHEN_ROTATION` about its origin, in metres.
"""

from __future__ import annotations

import numpy as np

from foresight_env.games.roads import Circle, Lane, RoadSide
from foresight_env.scenarios.intersection import IntersectionInstance, Region


def _fitted(polynomial: Lane, start: float, end: float) -> Lane:
    """A published polynomial between two places, fitted again in the frame of the line's ends.

    In the map's frame the turning lane climbs steeply on one side and comes back up on the other;
    in its own, slopes are moderate and the line continues straight where its points end.
    """
    line = polynomial.points(np.linspace(start, end, 400))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    even = np.arange(0.0, along[-1], 1.0)
    return Lane.fit(np.stack([np.interp(even, along, c) for c in line.T], axis=1))


def _walking_state(px: float, py: float, speed: float, heading: float) -> np.ndarray:
    """A pedestrian that is published as `[px, py, v, psi]`."""
    return np.array([px, py, speed * np.cos(heading), speed * np.sin(heading)])


AACHEN_ROTATION = 2.303611
"""rad; turns the recorded positions so that the roads lie along the axes."""
AACHEN_TURNING_POLYNOMIAL = Lane(
    (0.002435612807751, 0.212982977467914, 6.943601944356569, 100.2666455897435, 607.2095511007267)
)
"""The reference's, in the turned frame; meant from the northern arm (x = -12) west to x = -27."""
AACHEN_TURNING = _fitted(AACHEN_TURNING_POLYNOMIAL, -12.0, -27.0)
AACHEN_FOLLOWING = Lane((8.304049624037807, 186.6183521575921))
AACHEN_REGION = Region(
    corners=(
        Circle.through((-18.5, 69.0), (-16.5, 72.5), (-22.0, 68.0)),
        Circle.through((-7.0, 74.0), (-3.0, 69.0), (-6.0, 70.5)),
        Circle(Circle.through((-27.5, 58.5), (-22.5, 57.0), (-19.5, 52.0)).center, 7.55),
        Circle.through((-3.0, 58.0), (-7.5, 56.5), (-9.5, 52.0)),
    ),
    sides=(
        RoadSide((-22.0, 68.0), (-33.5, 68.0), "left"),
        RoadSide((-16.5, 72.5), (-13.5, 99.5), "right"),
        RoadSide((-3.0, 69.0), (8.5, 68.5), "right"),
        RoadSide((-7.0, 74.0), (-4.5, 99.0), "left"),
        RoadSide((-3.0, 58.0), (7.0, 58.0), "left"),
        RoadSide((-9.5, 52.0), (-12.5, 22.5), "right"),
        RoadSide((-27.5, 58.5), (-33.5, 58.5), "right"),
        RoadSide((-19.5, 51.5), (-21.5, 24.0), "left"),
    ),
    low=(-35.0, 20.0),
    high=(10.0, 100.0),
)
AACHEN = IntersectionInstance(
    ("pedestrian", "pedestrian", "car", "car"),
    (None, None, AACHEN_TURNING, AACHEN_FOLLOWING),
    AACHEN_REGION,
    np.stack(
        [
            _walking_state(-18.37, 66.26, 1.41, 1.32),
            _walking_state(-17.98, 66.28, 1.56, 1.23),
            np.array([-13.31, 76.94, 4.87, 4.55]),
            np.array([-11.35, 91.86, 4.67, 4.54]),
        ]
    ),
    np.array([[-16.0, 75.4], [-14.5, 76.1], [-25.0, 63.85], [-15.0, 62.06]]),
)
"""The paper's interaction at Aachen (inD recording 07, location 1): two people finish crossing the
western arm while a car turns into it and another follows. Goals are not published: pedestrians' are
where their velocity leads to, cars' lie on their lanes."""
