"""Scenes that forecasters learn from: moments of recordings and of episodes, as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from agents.egos.predict_then_plan import history_of
from agents.interfaces.predictor import History
from agents.learned.features import AGENTS, Features, features_of, targets_of
from evaluation.execution.store import Row
from evaluation.rollout.episode import observed_states
from evaluation.rollout.places import setting_of
from evaluation.windows.complete import near_groups
from evaluation.windows.interaction import (
    LEAST_OBSERVED,
    LEAST_PREDICTED,
    STEP_SECONDS,
    Grid,
    split_of,
)
from foresight_env.datasets import Recording, observed_window

LONG = 60.0
"""Recordings of more seconds than this are divided: their last `VALIDATION_PART` is kept from
training. Of shorter ones those of `VALIDATION` are kept from it as a whole."""
VALIDATION_PART = 0.2
VALIDATION = ("intersection_17",)


class Examples(NamedTuple):
    """S scenes: what networks see, and what they should have said."""

    seen: Features
    """Each array with a leading axis of S."""
    target: Float32[np.ndarray, "S A ahead 2"]
    known: Bool[np.ndarray, "S A ahead"]


def stack(scenes: Sequence[Examples]) -> Examples:
    """One after the other."""
    seen = Features(
        *(np.concatenate(parts) for parts in zip(*(s.seen for s in scenes), strict=True))
    )
    target, known = (
        np.concatenate([getattr(s, name) for s in scenes]) for name in ("target", "known")
    )
    return Examples(seen, target, known)


def mirrored(scenes: Examples) -> Examples:
    """The same scenes seen in a mirror: what is true of the left is true of the right."""
    seen = scenes.seen
    across = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], np.float32)
    flipped = seen._replace(past=seen.past * across[:5], others=seen.others * across)
    return scenes._replace(seen=flipped, target=scenes.target * across[:2])


def _one(history: History, truth: np.ndarray) -> Examples:
    seen, frames = features_of(history)
    target, known = targets_of(frames, truth, history.dt)
    return Examples(Features(*(v[None] for v in seen)), target[None], known[None])


def recorded_scenes(recording: Recording, part: str) -> Iterator[Examples]:
    """Of a development recording, the moments of a part: "train" or "validation".

    `ValueError` for a recording that tests are made on.
    """
    if split_of(recording.name) != "development":
        raise ValueError(f"recording: {recording.name} is for tests; nothing is learned from it")
    yield from scenes_in(recording, part)


def scenes_in(recording: Recording, part: str) -> Iterator[Examples]:
    """Of any recording, the moments of a part: "train" or "validation"."""
    grid = Grid.of(recording)
    start, end = recording.frame_range
    train = part == "train"
    low, high = start, end
    if (end - start) / recording.rate > LONG:
        # On the recording's own rows.
        steps = round((1.0 - VALIDATION_PART) * (end - start) / grid.every)
        border = start + steps * grid.every
        # No target of training is an input of validation.
        low, high = (start, border - grid.predicted * grid.every) if train else (border, end)
    elif train == (recording.name in VALIDATION):
        return
    first = low + (LEAST_OBSERVED - 1) * grid.every
    for frame in range(first, high - LEAST_PREDICTED * grid.every + 1, grid.every):
        yield from _moment(recording, grid, frame)


def _moment(recording: Recording, grid: Grid, frame: int) -> Iterator[Examples]:
    """Scenes of a moment: each agent observed for long enough is in one, with its neighbours."""
    around = frame - (LEAST_OBSERVED - 1) * grid.every, frame + LEAST_PREDICTED * grid.every
    names = [
        track.agent_id
        for track in recording.tracks
        if track.frames[0] <= around[0] and track.frames[-1] >= around[1]
    ]
    if not names:
        return
    begin = frame - (grid.observed - 1) * grid.every
    window = observed_window(recording, names, begin, grid.observed, grid.every)
    later = recording.window(names, frame + grid.every, grid.predicted, grid.every)
    now = window.states[-1, :, :2]
    ready = np.flatnonzero(np.isfinite(window.states[-1]).all(axis=1))
    for near, _ in near_groups(now[ready], len(ready), AGENTS):
        group = ready[near]
        history = History(
            window.states[:, group],
            window.headings[:, group],
            tuple(window.kinds[i] for i in group),
            window.extents[group],
            grid.dt,
        )
        yield _one(history, later.states[:, group, :2])


def simulated_scenes(row: Row) -> Iterator[Examples]:
    """Of an episode as `generation` makes it, with the ego's noise on all agents' states."""
    setting = setting_of(row["place"])
    scene = setting.make().scene
    count, steps, dt = row["players"], row["steps"], row["dt"]
    every = max(1, round(STEP_SECONDS / dt))
    states = np.array(row["states"]).reshape(steps + 1, count, 4)
    seen = observed_states(np.array(row["observations"]).reshape(steps, -1), row["ego"], count)
    first = (LEAST_OBSERVED - 1) * every
    for moment in range(first, steps + 1 - LEAST_PREDICTED * every, every):
        rows = range(max(moment % every, moment - 7 * every), moment + 1, every)
        plain = history_of(scene, tuple(seen[min(k, steps - 1)] for k in rows))
        history = History(plain.states, plain.headings, plain.kinds, plain.extents, every * dt)
        ahead = range(moment + every, steps + 1, every)
        yield _one(history, states[list(ahead), :, :2])
