"""A drawing surface with two coordinate systems: metres for the scene, pixels for the panel."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pygame
from jaxtyping import Float

from foresight_env.envs.rendering.style import Colour

Pixel = tuple[float, float]

DARK, FAINT, LIGHT = (40, 40, 40), (105, 105, 105), (255, 255, 255)
OVERSAMPLING = 2
DASH, GAP = 9.0, 6.0
"""Lengths along a dashed line, pixels."""
LEAST_DISC = 9.0
"""Radius of a pedestrian at least, pixels."""
HALO = (200, 30, 30)
HALO_GAP, HALO_WIDTH = 3.0, 4.0
"""Between an agent and the ring around it, and of the ring, pixels."""
GOAL_SIZE = 9.0
"""Half of a goal's cross, pixels."""


@lru_cache(maxsize=32)
def _font(size: int) -> pygame.font.Font:
    return pygame.font.Font(None, round(size * 1.45))  # pygame's own font: the same everywhere


def faded(colour: Colour) -> Colour:
    """A lighter colour of the same hue."""
    red, green, blue = (round(0.45 * part + 0.55 * 225) for part in colour)
    return red, green, blue


def _dashes(along: Float[np.ndarray, "K"]) -> list[Float[np.ndarray, "stops"]]:
    """Lengths along a line at which each of its dashes begins, bends and ends."""
    dashes = []
    for begin in np.arange(0.0, along[-1], DASH + GAP):
        end = min(begin + DASH, along[-1])
        inner = along[(along > begin) & (along < end)]
        dashes.append(np.concatenate([[begin], inner, [end]]))
    return dashes


class Canvas:
    """One picture in the making.

    Methods with a `place` take metres; those with pixels count from the top left of the finished
    picture.
    """

    def __init__(
        self,
        width: int,
        height: int,
        scene_width: int,
        centre: Float[np.ndarray, "2"],
        half_width: float,
    ) -> None:
        self._size = (width, height)
        self._scene_width = scene_width
        self._centre = centre
        self._middle = np.array([scene_width / 2.0, height / 2.0])
        self._scale = 0.5 * min(scene_width, height) / half_width
        size = (width * OVERSAMPLING, height * OVERSAMPLING)
        self._surface = pygame.Surface(size, depth=24)

    def finish(self) -> pygame.Surface:
        """The picture at its own size."""
        return pygame.transform.smoothscale(self._surface, self._size)

    def _pixels(self, places: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
        pixels = self._middle + self._scale * (places - self._centre) * (1.0, -1.0)
        # pygame draws with 32-bit coordinates; far outside is outside all the same.
        return pixels.clip(-1e4, 1e4)

    def _pixel(self, place: Float[np.ndarray, "2"] | Pixel) -> Pixel:
        x, y = self._pixels(np.reshape(place, (1, 2)))[0].tolist()
        return x, y

    @staticmethod
    def _fine(pixel: Pixel) -> Pixel:
        return pixel[0] * OVERSAMPLING, pixel[1] * OVERSAMPLING

    def fill(self, colour: Colour) -> None:
        """Cover everything."""
        self._surface.fill(colour)

    def polygon(self, corners: Float[np.ndarray, "K 2"], colour: Colour) -> None:
        """A filled polygon in the scene, corners in metres."""
        pygame.draw.polygon(self._surface, colour, (self._pixels(corners) * OVERSAMPLING).tolist())

    def circle(self, place: Float[np.ndarray, "2"], radius: float, colour: Colour) -> None:
        """A filled circle in the scene, metres."""
        size = radius * self._scale * OVERSAMPLING
        pygame.draw.circle(self._surface, colour, self._fine(self._pixel(place)), size)

    def box(
        self,
        place: Float[np.ndarray, "2"],
        heading: float,
        length: float,
        width: float,
        colour: Colour,
        ring: bool,
    ) -> None:
        """A car with its windscreen, metres and rad; `ring` marks a controlled one."""
        forward = np.array([np.cos(heading), np.sin(heading)])
        side = np.array([-forward[1], forward[0]])
        edge = (3.0 if ring else 1.5) / self._scale  # pixels, in metres
        for ink, inset in ((DARK if ring else LIGHT, 0.0), (colour, edge)):
            ahead, across = forward * (0.5 * length - inset), side * (0.5 * width - inset)
            corners = [-ahead - across, ahead - across, ahead + across, -ahead + across]
            self.polygon(place + np.array(corners), ink)
        front, back = 0.3 * length * forward, 0.18 * length * forward
        across = 0.36 * width * side
        glass = place + np.array([front - across, front + across, back + across, back - across])
        self.polygon(glass, faded(colour))

    def bar(self, top_left: Pixel, bottom_right: Pixel, colour: Colour) -> None:
        """A filled rectangle, corners in pixels."""
        left, top = self._fine(top_left)
        right, bottom = self._fine(bottom_right)
        box = pygame.Rect(round(left), round(top), round(right - left), round(bottom - top))
        pygame.draw.rect(self._surface, colour, box)

    def panel(self, width: float, colour: Colour) -> None:
        """Cover the right side, where the legend goes."""
        right, bottom = self._size
        self.bar((right - width, 0.0), (right, bottom), colour)
        self.bar((right - width, 0.0), (right - width + 1.0, bottom), (190, 190, 190))

    def path(self, path: Float[np.ndarray, "K 2"], colour: Colour, width: float) -> None:
        """A line through places."""
        self._lines(self._pixels(path), colour, width)

    def fading(
        self,
        path: Float[np.ndarray, "K 2"],
        opacity: Float[np.ndarray, "K"],
        colour: Colour,
        width: float,
        *,
        dashed: bool = False,
    ) -> None:
        """A line that fades along its way; where it leaves the scene it ends."""
        points = self._pixels(path)
        limits = self._scene_width, self._size[1]
        outside = np.flatnonzero(((points < 0.0) | (points > limits)).any(axis=1))
        if outside.size:
            points, opacity = points[: outside[0] + 1], opacity[: outside[0] + 1]
        if len(points) < 2:
            return
        layer = pygame.Surface(self._surface.get_size(), pygame.SRCALPHA)
        layer.fill((*colour, 0))
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        # Backwards, so that what counts more lies above what counts less.
        for stretch in reversed(_dashes(along) if dashed else [along]):
            pixels = np.stack([np.interp(stretch, along, points[:, k]) for k in (0, 1)], axis=1)
            shades = np.interp(stretch, along, opacity)
            for k in reversed(range(len(pixels) - 1)):
                shade = round(255 * 0.5 * (shades[k] + shades[k + 1]))
                self._lines(pixels[k : k + 2], (*colour, shade), width, layer)
        self._surface.blit(layer, (0, 0))

    def _lines(
        self,
        pixels: list[Pixel] | Float[np.ndarray, "K 2"],
        colour: Colour | tuple[int, int, int, int],
        width: float,
        surface: pygame.Surface | None = None,
    ) -> None:
        surface = self._surface if surface is None else surface
        fine = np.asarray(pixels, float) * OVERSAMPLING
        radius = 0.5 * width * OVERSAMPLING
        steps = np.diff(fine, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        moving = lengths > 0.0
        # Quadrangles: pygame's own wide lines get thinner the more they slope.
        sides = radius * (steps[moving] / lengths[moving, None])[:, ::-1] * (-1.0, 1.0)
        begin, end = fine[:-1][moving], fine[1:][moving]
        for corners in np.stack([begin + sides, end + sides, end - sides, begin - sides], axis=1):
            pygame.draw.polygon(surface, colour, corners)
        if radius > 1.5:
            for point in fine:
                pygame.draw.circle(surface, colour, point, radius)

    def disc(
        self, place: Float[np.ndarray, "2"], radius: float, colour: Colour, ring: bool
    ) -> None:
        """A pedestrian, never too small to see; `ring` marks a controlled one."""
        self._round(self._pixel(place), max(radius * self._scale, LEAST_DISC), colour, ring)

    def sample_disc(self, pixel: Pixel, colour: Colour, ring: bool) -> None:
        """A small pedestrian for the legend."""
        self._round(pixel, 10.0, colour, ring)

    def _round(self, pixel: Pixel, radius: float, colour: Colour, ring: bool) -> None:
        centre, size = self._fine(pixel), radius * OVERSAMPLING
        pygame.draw.circle(self._surface, DARK if ring else LIGHT, centre, size)
        pygame.draw.circle(
            self._surface, colour, centre, size - (3.0 if ring else 1.5) * OVERSAMPLING
        )

    def halo(self, place: Float[np.ndarray, "2"], radius: float) -> None:
        """Mark an agent whose action a safety filter replaced."""
        self._halo(self._pixel(place), max(radius * self._scale, LEAST_DISC))

    def _halo(self, pixel: Pixel, radius: float) -> None:
        centre, size = self._fine(pixel), OVERSAMPLING * (radius + HALO_GAP + HALO_WIDTH)
        pygame.draw.circle(self._surface, HALO, centre, size, round(OVERSAMPLING * HALO_WIDTH))

    def burst(self, place: Float[np.ndarray, "2"], radius: float) -> None:
        """Mark a collision."""
        self._spokes(self._pixel(place), radius * self._scale)

    def _spokes(self, pixel: Pixel, radius: float) -> None:
        for angle in np.arange(8) * np.pi / 4.0:
            ray = np.array([np.cos(angle), np.sin(angle)])
            ends = [tuple(np.array(pixel) + r * radius * ray) for r in (1.15, 1.5)]
            self._lines(ends, DARK, 2.5)

    def cross(self, place: Float[np.ndarray, "2"], colour: Colour) -> None:
        """A goal."""
        self._cross(self._pixel(place), GOAL_SIZE, colour)

    def _cross(self, pixel: Pixel, radius: float, colour: Colour) -> None:
        x, y = pixel
        for width, ink in ((7.0, LIGHT), (3.5, colour)):
            for sign in (1.0, -1.0):
                ends = [(x - radius, y - sign * radius), (x + radius, y + sign * radius)]
                self._lines(ends, ink, width)

    def sample(self, kind: str, pixel: Pixel) -> None:
        """Sample of a kind of line or mark, 32 pixels wide, for the legend."""
        x, y = pixel
        line = [(x, y), (x + 32.0, y)]
        if kind == "trail":
            self._lines(line, faded(FAINT), 5)
        elif kind == "goal":
            self._cross((x + 16.0, y), 7.0, FAINT)
        elif kind == "true plan":
            self._lines(line, FAINT, 1.5)
        elif kind == "prediction":
            for begin, *_, end in _dashes(np.array([0.0, 32.0])):
                self._lines([(x + begin, y), (x + end, y)], FAINT, 3)
        elif kind == "own plan":
            self._lines(line, FAINT, 3)
        elif kind == "intervention":
            self._halo((x + 16.0, y), 1.0)
        elif kind == "collision":
            self._spokes((x + 16.0, y), 6.0)
        else:
            raise ValueError(f"kind: there is no sample of {kind!r}")

    def label(self, text: str, place: Float[np.ndarray, "2"], ground: Colour) -> None:
        """Text in the middle of a place, light or dark as stands out from `ground`."""
        brightness = float(np.dot(ground, (0.299, 0.587, 0.114)))
        ink = DARK if brightness > 140.0 else LIGHT
        image = _font(19 * OVERSAMPLING).render(text, True, ink)
        fine_x, fine_y = self._fine(self._pixel(place))
        self._surface.blit(image, image.get_rect(center=(round(fine_x), round(fine_y))))

    def text(
        self,
        text: str,
        pixel: Pixel,
        *,
        size: int,
        colour: Colour = DARK,
        centred: bool = False,
    ) -> None:
        """Text with its top left, or the middle of its top, at a pixel; `size` in pixels."""
        image = _font(size * OVERSAMPLING).render(text, True, colour)
        left, top = self._fine(pixel)
        left -= 0.5 * image.get_width() if centred else 0.0
        self._surface.blit(image, (round(left), round(top)))

    def whisker(self, ends: tuple[float, float], y: float) -> None:
        """A horizontal interval with end marks, light-edged so that it shows on every colour."""
        for width, ink in ((4.5, LIGHT), (2.0, DARK)):
            self._lines([(ends[0], y), (ends[1], y)], ink, width)
            for x in ends:
                self._lines([(x, y - 4.0), (x, y + 4.0)], ink, width)

    def tick(self, x: float, top: float, bottom: float) -> None:
        """A vertical mark."""
        for width, ink in ((6.0, LIGHT), (3.0, DARK)):
            self._lines([(x, top), (x, bottom)], ink, width)
