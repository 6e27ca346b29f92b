"""How an episode ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

COLLISION, OFF_ROAD, REACHED, TIME_OUT = "collision", "off road", "goal reached", "time-out"
HARM = (COLLISION, OFF_ROAD)
"""Endings that are worse than any cost."""


def harmed(row: Mapping[str, Any]) -> bool:
    """Whether the episode of a study's row ended in a collision or off the road."""
    return row["ended"] in HARM


def time_to_goal(row: Mapping[str, Any]) -> float:
    """Time to the goal in a study's row, s; the time limit where it was not reached."""
    return float(row["time"] if row["ended"] == REACHED else row["time_limit"])


def ending(info: Mapping[str, Any]) -> str:
    """One of the four, from an ego's information after the last step; harm counts first."""
    if info["collision"]:
        return COLLISION
    if info["off_road"]:
        return OFF_ROAD
    return REACHED if info["is_success"] else TIME_OUT
