"""Windows of 8 observed and 12 predicted steps, in which every counted agent is always present.

The rule of ETH/UCY (Alahi et al., "Social LSTM", CVPR 2016; Gupta et al., "Social GAN", CVPR 2018),
for a recording of any format:

- a window is every 20 consecutive steps of `STEP_SECONDS`, beginning at each row of the recording;
- an agent counts where it is present in all 20. Social GAN's code keeps windows in which more than
  `min_ped = 1` agents count (`sgan/data/trajectories.py`), that is `LEAST_AGENTS` at least;
- only positions of the 8 observed steps are given: velocities are the differences between them.

Models of this library predict agents jointly, so a window is divided into histories: the first
agent that is not counted yet, and the nearest agents present now within `REACH`, up to
`MOST_AGENTS`. An agent counts in the first history that it is in; in later ones, or where it is
present now but not in all 20 steps, it is context, if it was observed `LEAST_OBSERVED` times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from agents.interfaces.predictor import History
from evaluation.windows.interaction import STEP_SECONDS
from foresight_env.datasets import Recording, past_velocities

OBSERVED = 8
PREDICTED = 12
LEAST_AGENTS = 2
"""Agents that count in a window of the protocol, at least."""
LEAST_OBSERVED = 2
"""Observed steps in which an agent that does not count must be present to be context."""
REACH = 20.0
"""Agents farther from a history's first agent are not in it, m."""
MOST_AGENTS = 8
"""Of a history."""


@dataclass(frozen=True, eq=False)
class CompleteWindow:
    """A history of agents near each other, and the ground truth of those that count."""

    frame: int
    """Of the last observed step."""
    agents: tuple[str, ...]
    history: History
    truth: Float[np.ndarray, "P N 2"]
    """Positions of the predicted steps, m; NaN where an agent is absent."""
    counted: Bool[np.ndarray, "N"]
    """Agents that are judged in this history: present in all steps and in no earlier history."""


def step_frames(recording: Recording) -> int:
    """Frame numbers per step: as near to `STEP_SECONDS` as the recording's rows allow."""
    rows = max(1, round(STEP_SECONDS * recording.rate / recording.frame_step))
    return int(rows * recording.frame_step)


def complete_agents(recording: Recording) -> dict[int, tuple[str, ...]]:
    """Return the agents that count in each window, by its last observed frame, in order."""
    every = step_frames(recording)
    steps = every * np.arange(OBSERVED + PREDICTED)
    found: dict[int, list[str]] = {}
    for track in recording.tracks:
        whole = np.isin(track.frames[:, None] + steps, track.frames).all(axis=1)
        for first in track.frames[whole]:
            found.setdefault(int(first + steps[OBSERVED - 1]), []).append(track.agent_id)
    return {frame: tuple(found[frame]) for frame in sorted(found)}


def histories_at(
    recording: Recording, frame: int, complete: Sequence[str]
) -> Iterator[CompleteWindow]:
    """Yield the histories of a window, so that each agent of `complete` counts in exactly one.

    Args:
        recording: With the agents.
        frame: The window's last observed frame.
        complete: The agents that count there, of `complete_agents`.
    """
    every = step_frames(recording)
    first = frame - (OBSERVED - 1) * every
    names = [*complete, *_context(recording, frame, complete)]
    window = recording.window(names, first, OBSERVED + PREDICTED, every)
    states = window.states[:OBSERVED].copy()
    for i, name in enumerate(names):
        track = recording.track(name)
        shown = track.restricted(np.isin(track.frames, window.frames[:OBSERVED]))
        states[:, i, 2:] = past_velocities(shown, window.frames[:OBSERVED], recording.rate)
    groups = near_groups(states[-1, :, :2], len(complete))
    for group, counted in groups:
        history = History(
            states[:, group],
            window.headings[:OBSERVED, group],
            tuple(window.kinds[i] for i in group),
            window.extents[group],
            every / recording.rate,
        )
        yield CompleteWindow(
            frame,
            tuple(names[i] for i in group),
            history,
            window.states[OBSERVED:, group, :2],
            counted,
        )


def near_groups(
    places: Float[np.ndarray, "N 2"], count: int, most: int = MOST_AGENTS
) -> list[tuple[list[int], Bool[np.ndarray, "_"]]]:
    """Return groups of agents near each other, and which of a group count in it.

    Each of the first `count` agents counts once; the others never. `places`: now, m. `most`: agents
    of a group.
    """
    waiting = list(range(count))
    found = []
    while waiting:
        away = np.linalg.norm(places - places[waiting[0]], axis=1)
        away[waiting[0]] = -1.0  # first, even where another agent stands at the same place
        group = [int(k) for k in np.argsort(away, kind="stable") if away[k] <= REACH][:most]
        found.append((group, np.array([i in waiting for i in group])))
        waiting = [i for i in waiting if i not in group]
    return found


def _context(recording: Recording, frame: int, complete: Sequence[str]) -> list[str]:
    """Agents that are present now and were observed before, but are not in all steps."""
    every = step_frames(recording)
    observed = frame - every * np.arange(OBSERVED)
    known = set(complete)
    return [
        track.agent_id
        for track in recording.tracks
        if track.frames[0] <= frame <= track.frames[-1]
        and track.agent_id not in known
        and frame in track.frames
        and int(np.isin(observed, track.frames).sum()) >= LEAST_OBSERVED
    ]
