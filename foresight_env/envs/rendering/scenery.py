"""The ground that agents move on, as shapes to be drawn; metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from foresight_env.envs.rendering.style import Colour
from foresight_env.games.roads import Point

PAVEMENT: Colour = (240, 238, 233)
ASPHALT: Colour = (201, 203, 207)
STRIPE: Colour = (247, 247, 247)


class Polygon(NamedTuple):
    """A filled polygon."""

    corners: tuple[Point, ...]
    colour: Colour


class Disc(NamedTuple):
    """A filled disc."""

    center: Point
    radius: float
    colour: Colour


def rectangle(low: Point, high: Point, colour: Colour) -> Polygon:
    """A rectangle along the axes."""
    return Polygon((low, (high[0], low[1]), high, (low[0], high[1])), colour)


@dataclass(frozen=True)
class Scenery:
    """Shapes in the order in which they are painted, on pavement."""

    title: str
    center: Point
    half_width: float
    """Half of the shown width at least, m."""
    shapes: tuple[Polygon | Disc, ...] = ()
