"""From where an episode's hidden parameters are drawn."""

from __future__ import annotations

from typing import NamedTuple


class DrivingRanges(NamedTuple):
    """Everything is drawn uniformly."""

    gamma: tuple[float, float] = (0.7, 1.0)
    """Per step of 0.1 s: at 0.7 what lies half a second ahead counts a sixth."""
    along: float = 1.5
    """Largest shift of a car's start along its path, m."""
    speed: float = 0.5
    """Largest difference of start and target speeds from their nominal ones, m/s."""
