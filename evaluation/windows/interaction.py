"""Windows of recordings in which agents interact: history and ground truth.

The rule. A window is a moment of a recording and a group of agents:

- moments are `STEP_SECONDS` apart; `OBSERVED_SECONDS` before one are given to predictors, and the
  `PREDICTED_SECONDS` after it are predicted;
- two agents interact when their paths cross (`closest_crossings`: at 30 degrees or more, within
  half a metre, within 5 s of each other), the first of them no later than the end of the window and
  the second not before the moment, and they come within `NEAR` of each other after it;
- both are seen in the last `LEAST_OBSERVED` steps and in the next `LEAST_PREDICTED`: clips that are
  shorter than a whole window count for as long as they last, what is missing is not compared;
- agents that interact with each other, directly or through others, form a group. One of more than
  `MOST_AGENTS` is divided: pairs join in the order of how close they come, as long as the group
  does not grow larger.

Groups are ordered by kind, then by id.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from agents.interfaces.predictor import Context, History
from foresight_env.datasets import (
    Interaction,
    Recording,
    RouteMemory,
    closest_crossings,
    observed_window,
)

STEP_SECONDS = 0.4
"""Target time between steps; UCY has exactly this, DUT is taken every tenth frame."""
OBSERVED_SECONDS = 3.0
PREDICTED_SECONDS = 4.0
NEAR = 5.0
"""Agents that come this close interact, m."""
LEAST_OBSERVED = 4
"""Steps, the moment among them, in which every agent has been observed."""
LEAST_PREDICTED = 3
"""Steps after the moment in which every agent is still observed."""
MOST_AGENTS = 4
DEVELOPMENT = (
    "07",
    "22",
    "intersection_01",
    "intersection_03",
    "intersection_04",
    "intersection_05",
    "intersection_06",
    "intersection_07",
    "intersection_13",
    "intersection_17",
    "roundabout_04",
    "zara01",
    "eth",
    "hotel",
    "students03",
)
"""Recordings that settings are chosen on; all others are for tests alone. inD's are 07 and 22."""


def split_of(recording: str) -> str:
    """ "development" or "test"."""
    return "development" if recording in DEVELOPMENT else "test"


@dataclass(frozen=True, eq=False)
class PredictionWindow:
    """A moment of a recording: the history given to predictors, and the ground truth."""

    recording: str
    agents: tuple[str, ...]
    frame: int
    """Of the moment, the last that is given."""
    history: History
    truth: Float[np.ndarray, "P N 2"]
    """Positions of the steps after it, m; NaN where an agent had left."""

    @property
    def present(self) -> Bool[np.ndarray, "P N"]:
        """Steps with a ground truth."""
        return ~np.isnan(self.truth[..., 0])

    @property
    def seen_steps(self) -> int:
        """Observations of the agent that was seen least."""
        return min(len(self.history.seen(i)) for i in range(len(self.agents)))


@dataclass(frozen=True)
class Grid:
    """How a recording is divided into steps."""

    every: int
    """Frames per step."""
    dt: float
    observed: int
    predicted: int

    @staticmethod
    def of(recording: Recording) -> Grid:
        """Steps as near to `STEP_SECONDS` as the recording's rows allow."""
        rows = max(1, round(STEP_SECONDS * recording.rate / recording.frame_step))
        every = rows * recording.frame_step
        dt = every / recording.rate
        observed = round(OBSERVED_SECONDS / dt) + 1
        return Grid(every, dt, observed, math.ceil(PREDICTED_SECONDS / dt - 1e-6))


def moments(recording: Recording, grid: Grid) -> range:
    """Frames at which windows may begin to predict."""
    start, end = recording.frame_range
    first = start + (LEAST_OBSERVED - 1) * grid.every
    return range(first, end - LEAST_PREDICTED * grid.every + 1, grid.every)


def cut(
    recording: Recording,
    agents: Sequence[str],
    frame: int,
    routes: RouteMemory | None = None,
) -> PredictionWindow:
    """The window of these agents at a moment; ValueError when one was not seen before it.

    `routes`: the recording's; None: they are learned again.
    """
    grid = Grid.of(recording)
    first = frame - (grid.observed - 1) * grid.every
    window = observed_window(recording, agents, first, grid.observed, grid.every)
    later = recording.window(agents, frame + grid.every, grid.predicted, grid.every)
    known_routes = (routes or RouteMemory(recording)).before(frame)
    history = History(
        window.states,
        window.headings,
        window.kinds,
        window.extents,
        grid.dt,
        Context(tuple(r.path for r in known_routes), np.array([r.frequency for r in known_routes])),
    )
    return PredictionWindow(recording.name, window.agents, frame, history, later.states[..., :2])


def interaction_windows(recording: Recording) -> tuple[PredictionWindow, ...]:
    """All windows of a recording by the module's rule, in the order of time."""
    if not recording.tracks:
        return ()
    grid = Grid.of(recording)
    crossings = closest_crossings(
        recording, max_distance=NEAR, min_overlap_seconds=LEAST_OBSERVED * grid.dt
    )
    routes = RouteMemory(recording)
    found = []
    for frame in moments(recording, grid):
        pairs = sorted(
            (distance, crossing.agents)
            for crossing in crossings
            if (distance := _least_distance(recording, grid, crossing, frame)) < NEAR
        )
        for group in joined([agents for _, agents in pairs]):
            ordered = sorted(group, key=lambda agent: (recording.track(agent).kind, agent))
            found.append(cut(recording, ordered, frame, routes))
    return tuple(found)


def _least_distance(recording: Recording, grid: Grid, crossing: Interaction, frame: int) -> float:
    """How close a pair comes after a moment, m; infinite where it has no window there."""
    now = frame / recording.rate
    if crossing.times[1] <= now or crossing.times[0] >= now + PREDICTED_SECONDS:
        return math.inf
    first = frame - (LEAST_OBSERVED - 1) * grid.every
    steps = LEAST_OBSERVED + grid.predicted
    window = recording.window(crossing.agents, first, steps, grid.every)
    if not window.present[: LEAST_OBSERVED + LEAST_PREDICTED].all():
        return math.inf
    later = window.states[LEAST_OBSERVED:, :, :2]
    return float(np.nanmin(np.linalg.norm(later[:, 0] - later[:, 1], axis=1)))


def joined(pairs: Sequence[tuple[str, str]]) -> list[frozenset[str]]:
    """Pairs joined, in their order, to groups of at most `MOST_AGENTS`."""
    group: dict[str, frozenset[str]] = {}
    for first, second in pairs:
        both = group.get(first, frozenset({first})) | group.get(second, frozenset({second}))
        if len(both) <= MOST_AGENTS:
            group.update(dict.fromkeys(both, both))
    return sorted(set(group.values()), key=sorted)


def connected(windows: Sequence[PredictionWindow]) -> list[str]:
    """For each window, the name of the set of windows that it shares agents with, if indirectly."""
    leader: dict[str, str] = {}

    def find(agent: str) -> str:
        while leader.setdefault(agent, agent) != agent:
            agent = leader[agent]
        return agent

    members = [[f"{w.recording} {a}" for a in w.agents] for w in windows]
    for group in members:
        for first, second in combinations(group, 2):
            leader[find(first)] = find(second)
    return [find(group[0]) for group in members]
