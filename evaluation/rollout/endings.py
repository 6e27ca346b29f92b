"""How an episode ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

COLLISION, OFF_ROAD, REACHED, TIME_OUT = "collision", "off road", "goal reached", "time-out"
HARM = (COLLISION, OFF_ROAD)
"""Endings that are worse than any cost."""


def ending(info: Mapping[str, Any]) -> str:
    """One of the four, from an ego's information after the last step; harm counts first."""
    if info["collision"]:
        return COLLISION
    if info["off_road"]:
        return OFF_ROAD
    return REACHED if info["is_success"] else TIME_OUT
