"""From where an episode's hidden parameters are drawn."""

from __future__ import annotations

from typing import NamedTuple

from foresight_env.scenarios.ranges import check_ranges

LARGEST_SHIFTS = {"along": 2.0, "speed": 2.0}
"""Of `DrivingRanges`, m and m/s: no car begins inside another, or without path behind it."""


class DrivingRanges(NamedTuple):
    """Everything is drawn uniformly."""

    gamma: tuple[float, float] = (0.7, 1.0)
    """Per step of 0.1 s: at 0.7 what lies half a second ahead counts a sixth."""
    along: float = 1.5
    """Largest shift of a car's start along its path, m."""
    speed: float = 0.5
    """Largest difference of start and target speeds from their nominal ones, m/s."""

    def check(self) -> None:
        """Raise `ValueError` where a draw might be no legal episode."""
        check_ranges(self, ("gamma",), LARGEST_SHIFTS)
