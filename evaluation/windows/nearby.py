"""Windows of all traffic: every moment of a recording, agents near each other as groups.

The rule. Moments and lengths are those of `evaluation.windows.interaction`. An agent counts where
it is seen in the last `LEAST_OBSERVED` steps and in the next `LEAST_PREDICTED`, and has moved by
`MOVED` in the former. Agents within `NEARBY` of each other at the moment form groups of at most
`MOST_AGENTS`; closest pairs join first. An agent without such a neighbour is a group of one.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from evaluation.windows.interaction import (
    LEAST_OBSERVED,
    LEAST_PREDICTED,
    Grid,
    PredictionWindow,
    cut,
    joined,
    moments,
)
from foresight_env.datasets import Recording, RouteMemory

NEARBY = 15.0
"""m."""
MOVED = 0.5
"""m: parked cars are easy to predict."""


def nearby_windows(recording: Recording) -> tuple[PredictionWindow, ...]:
    """All windows of a recording by the module's rule, in the order of time."""
    if not recording.tracks:
        return ()
    grid = Grid.of(recording)
    routes = RouteMemory(recording)
    found = []
    for frame in moments(recording, grid):
        agents = _moving(recording, grid, frame)
        places = {agent: place for agent, place in agents}
        pairs = sorted(
            (distance, (a, b))
            for a, b in combinations(places, 2)
            if (distance := float(np.hypot(*(places[a] - places[b])))) < NEARBY
        )
        groups = joined([names for _, names in pairs])
        alone = set(places) - {name for group in groups for name in group}
        for group in [*groups, *(frozenset({name}) for name in sorted(alone))]:
            ordered = sorted(group, key=lambda agent: (recording.track(agent).kind, agent))
            found.append(cut(recording, ordered, frame, routes))
    return tuple(found)


def _moving(recording: Recording, grid: Grid, frame: int) -> list[tuple[str, np.ndarray]]:
    """Agents that count at a moment, and where they are."""
    names = [t.agent_id for t in recording.tracks if t.frames[0] <= frame <= t.frames[-1]]
    if not names:
        return []
    first = frame - (LEAST_OBSERVED - 1) * grid.every
    window = recording.window(names, first, LEAST_OBSERVED + LEAST_PREDICTED, grid.every)
    places = window.states[:, :, :2]
    moved = np.linalg.norm(places[LEAST_OBSERVED - 1] - places[0], axis=1) >= MOVED
    return [
        (name, places[LEAST_OBSERVED - 1, i])
        for i, name in enumerate(names)
        if window.present[:, i].all() and moved[i]
    ]
