"""Drawing with pygame: scenery, agents, trajectories and inferred foresight.

Frames are drawn at twice their size and scaled down, which smooths edges. No display is needed for
`"rgb_array"`. Colours are those of Okabe and Ito, distinguishable with colour-blindness.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import pygame
from jaxtyping import Bool, Float, UInt8

from foresight_env.envs.rendering.canvas import DARK, FAINT, Canvas, faded
from foresight_env.envs.rendering.overlay import Overlay
from foresight_env.envs.rendering.scenery import PAVEMENT, Disc, Scenery
from foresight_env.envs.rendering.style import COLOURS, INTERVAL_DEVIATIONS
from foresight_env.games.footprints import Footprint

WIDTH, HEIGHT = 900, 620
PANEL = 260
LEAST_WEIGHT = 0.05
"""Value of `gamma ** k` below which a plan or prediction is not drawn any more."""
MARGIN = 0.2
"""Free space around everything, as a part of half the shown width."""


class Frame(NamedTuple):
    """All that one picture shows."""

    names: tuple[str, ...]
    """Of the players' agents."""
    footprints: tuple[Footprint, ...]
    trail: Float[np.ndarray, "steps N 2"]
    """Positions so far, the present ones last, m."""
    headings: Float[np.ndarray, "N"]
    """Present headings, rad."""
    goals: Float[np.ndarray, "N 2"]
    gamma: Float[np.ndarray, "N"]
    """True discount factors: what plans are weighed with."""
    controlled: tuple[int, ...]
    collided: Bool[np.ndarray, "N"]
    planned: Sequence[Float[np.ndarray, "K 2"]]
    """Plans of each player by the behaviour of uncontrolled agents; empty: none."""
    overlay: Overlay
    time: float
    """Seconds since the episode began."""


class Renderer:
    """Draws frames into a window or into arrays."""

    def __init__(
        self, mode: Literal["human", "rgb_array"], frames_per_second: int, scenery: Scenery
    ) -> None:
        pygame.font.init()
        self._scenery = scenery
        self._rate = frames_per_second
        self._window: pygame.Surface | None = None
        self._clock: pygame.time.Clock | None = None
        if mode == "human":
            try:
                pygame.display.init()
                _check_display(pygame.display.get_driver())
                pygame.display.set_caption(f"foresight_env: {scenery.title}")
                self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            except pygame.error as error:
                raise OSError(
                    f"render_mode: 'human' needs a display ({error}); use 'rgb_array' without one"
                ) from error
            self._clock = pygame.time.Clock()

    def draw(self, frame: Frame) -> UInt8[np.ndarray, "H W 3"] | None:
        """The picture; None when it went into the window."""
        scenery = self._scenery
        half_width = _half_width(frame, scenery)
        canvas = Canvas(WIDTH, HEIGHT, WIDTH - PANEL, np.array(scenery.center), half_width)
        canvas.fill(PAVEMENT)
        for shape in scenery.shapes:
            if isinstance(shape, Disc):
                canvas.circle(np.array(shape.center), shape.radius, shape.colour)
            else:
                canvas.polygon(np.array(shape.corners), shape.colour)
        _trajectories(canvas, frame)
        _agents(canvas, frame)
        canvas.panel(PANEL, PAVEMENT)
        _gamma_bars(canvas, frame, _legend(canvas, frame))
        picture = canvas.finish()
        if self._window is None or self._clock is None:
            return np.transpose(pygame.surfarray.array3d(picture), (1, 0, 2)).copy()
        pygame.event.pump()
        self._window.blit(picture, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._rate)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None


def _check_display(driver: str) -> None:
    """Without a display, SDL may draw into memory, and the window would be invisible."""
    wanted = os.environ.get("SDL_VIDEODRIVER", "").split(",")
    if driver in ("dummy", "offscreen") and driver not in wanted:
        pygame.display.quit()
        raise pygame.error("none was found")


def _half_width(frame: Frame, scenery: Scenery) -> float:
    """Half of the shown width: no agent is ever outside, and the view never shrinks again."""
    places = np.concatenate([frame.trail.reshape(-1, 2), frame.goals])
    farthest = float(np.abs(places - np.array(scenery.center)).max())
    return max(scenery.half_width, farthest + MARGIN * scenery.half_width)


def _trajectories(canvas: Canvas, frame: Frame) -> None:
    for i, goal in enumerate(frame.goals):
        canvas.cross(goal, COLOURS[i])
        canvas.path(frame.trail[:, i], faded(COLOURS[i]), width=5)
    for i, path in enumerate(frame.planned):
        if i not in frame.controlled:
            canvas.fading(path, _opacity(len(path), frame.gamma[i]), COLOURS[i], width=1.5)
    likely = max((a.weight for a in frame.overlay.alternatives), default=0.0)
    for alternative in frame.overlay.alternatives:
        if alternative.weight < likely:
            for i, path in alternative.predicted.items():
                canvas.fading(path, np.ones(len(path)), COLOURS[i], width=1.5, dashed=True)
    for i, path in frame.overlay.predicted.items():
        gamma, _ = frame.overlay.gammas.get(i, (1.0, 0.0))
        canvas.fading(path, _opacity(len(path), gamma), COLOURS[i], width=3, dashed=True)
    if frame.overlay.planned is not None:
        path, ego = frame.overlay.planned, frame.controlled[0]
        canvas.fading(path, _opacity(len(path), frame.gamma[ego]), COLOURS[ego], width=3)


def _opacity(count: int, gamma: float) -> Float[np.ndarray, "count"]:
    """How strongly each place of a path is drawn: what the agent hardly weighs is left out."""
    weight = np.minimum(gamma, 1.0) ** np.arange(count)
    return np.where(weight < LEAST_WEIGHT, 0.0, np.sqrt(weight))


def _agents(canvas: Canvas, frame: Frame) -> None:
    places = frame.trail[-1]
    for struck in np.flatnonzero(frame.collided):
        # First, so that it hides no agent's number.
        canvas.burst(places[struck], frame.footprints[struck].reach)
    if frame.overlay.intervention:
        ego = frame.controlled[0]
        canvas.halo(places[ego], frame.footprints[ego].reach)
    for i, (place, shape) in enumerate(zip(places, frame.footprints, strict=True)):
        controlled = i in frame.controlled
        if shape.length > 0.0:
            canvas.box(place, frame.headings[i], shape.length, shape.width, COLOURS[i], controlled)
        else:
            canvas.disc(place, shape.radius, COLOURS[i], ring=controlled)
        canvas.label(str(i), place, COLOURS[i])


def _legend(canvas: Canvas, frame: Frame) -> float:
    """Legend of agents and lines; returns the place of the next block."""
    left, y = WIDTH - PANEL + 20.0, 18.0
    canvas.text(f"time {frame.time:.1f} s", (left, y), size=20)
    y += 38
    for i in range(len(frame.goals)):
        role = "controlled" if i in frame.controlled else "uncontrolled"
        canvas.sample_disc((left + 11, y + 9), COLOURS[i], ring=i in frame.controlled)
        canvas.text(frame.names[i].replace("_", " "), (left + 32, y), size=15)
        canvas.text(role, (left + 132, y), size=15, colour=FAINT)
        y += 26
    y += 10
    # Neutral, because each line is drawn in the colour of its agent.
    kinds = ["trail", "goal"]
    kinds += ["true plan"] if frame.planned else []
    kinds += ["prediction"] if frame.overlay.predicted else []
    kinds += ["own plan"] if frame.overlay.planned is not None else []
    kinds += ["intervention"] if frame.overlay.intervention else []
    kinds += ["collision"] if frame.collided.any() else []
    names = {
        "true plan": "plan of uncontrolled",
        "prediction": "predicted by agent",
        "own plan": "agent's own plan",
        "intervention": "safety filter acts",
    }
    for kind in kinds:
        canvas.sample(kind, (left, y + 9))
        canvas.text(names.get(kind, kind), (left + 44, y), size=15)
        y += 24
    if {"true plan", "prediction", "own plan"} & set(kinds):
        canvas.text("plans fade as they weigh less", (left, y), size=13, colour=FAINT)
        y += 20
    if frame.overlay.alternatives:
        y += 8
        canvas.text("agent's hypotheses", (left, y), size=15)
        y += 22
        likely = max(a.weight for a in frame.overlay.alternatives)
        for alternative in frame.overlay.alternatives:
            drawn = "bold" if alternative.weight == likely else "thin"
            told = f"{alternative.name}: {alternative.weight:.0%}, {drawn}"
            canvas.text(told, (left + 10, y), size=13, colour=DARK)
            y += 18
    return y + 16


def _gamma_bars(canvas: Canvas, frame: Frame, top: float) -> None:
    """Inferred discount factors with their 90 % intervals, the truth as a tick."""
    known = sorted({*frame.overlay.gammas, *frame.overlay.truth_gammas})
    if not known:
        return
    left, right = WIDTH - PANEL + 44.0, WIDTH - 24.0
    means = [pair[0] for pair in frame.overlay.gammas.values()]
    top_value = max(1.0, *means, *frame.overlay.truth_gammas.values(), 0.0)

    def at(value: float) -> float:
        return left + (right - left) * min(max(value / top_value, 0.0), 1.0)

    canvas.text("discount factor gamma", (WIDTH - PANEL + 20, top), size=15)
    y = top + 30
    for i in known:
        canvas.text(str(i), (WIDTH - PANEL + 22, y - 1), size=15, colour=COLOURS[i])
        canvas.bar((left, y), (right, y + 14), (223, 221, 216))
        if i in frame.overlay.gammas:
            mean, deviation = frame.overlay.gammas[i]
            canvas.bar((left, y), (at(mean), y + 14), COLOURS[i])
            half = INTERVAL_DEVIATIONS * deviation
            ends = at(mean - half), at(mean + half)
            canvas.whisker(ends, y + 7)
        if i in frame.overlay.truth_gammas:
            canvas.tick(at(frame.overlay.truth_gammas[i]), y - 4, y + 18)
        y += 28
    for value in (0.0, 0.5, 1.0):
        canvas.text(f"{value:g}", (at(value), y - 4), size=13, colour=FAINT, centred=True)
    y += 18
    if frame.overlay.gammas:
        canvas.whisker((left - 20, left + 4), y + 9)
        canvas.text("inferred, 90 % interval", (left + 16, y), size=13, colour=DARK)
        y += 20
    if frame.overlay.truth_gammas:
        canvas.tick(left - 8, y, y + 17)
        canvas.text("true value", (left + 16, y), size=13, colour=DARK)
