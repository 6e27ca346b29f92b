"""Examples that `hybrid-game` learns from: moments of recordings and of simulated episodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import jax
import numpy as np

from agents.egos.predict_then_plan import history_of
from agents.hybrid.loss import Example
from agents.hybrid.scene import scene_of, targets
from agents.hybrid.strategies import HORIZON, STEPS
from agents.interfaces.predictor import Context, History
from agents.learned.features import AGENTS
from evaluation.execution.store import Row
from evaluation.rollout.episode import observed_states
from evaluation.rollout.places import setting_of
from evaluation.windows.complete import near_groups
from evaluation.windows.interaction import (
    LEAST_OBSERVED,
    LEAST_PREDICTED,
    STEP_SECONDS,
    Grid,
    interaction_windows,
)
from foresight_env.datasets import Recording, RouteMemory, observed_window

LEAST_SEEN = 2
"""Observations of an agent that is in a scene for the others' sake."""


def stacked(examples: Sequence[Example]) -> Example:
    """One array of all examples for each of one's."""
    found: Example = jax.tree.map(lambda *parts: np.stack(parts), *examples)
    return found


def example_of(history: History, truth: np.ndarray, agents: int = AGENTS) -> Example:
    """The example of a moment; `truth`: (P, N, 2) positions that followed, m."""
    scene, middle = scene_of(history, agents)
    return Example(scene, *targets(scene, middle, truth, history.dt, STEPS))


def recorded_examples(
    recording: Recording,
    agents: int = AGENTS,
    span: tuple[float, float] = (0.0, 1.0),
    phases: int = 1,
) -> Iterator[Example]:
    """Every agent that is observed for long enough is in a scene of each moment, with others.

    Args:
        agents: places of a scene.
        span: part of the recording, by frames, that all steps of an example lie in.
        phases: at least so many moments per step, as far as the recording has rows between.

    Raises:
        ValueError: `phases` is less than 1.
    """
    if phases < 1:
        raise ValueError(f"phases: is {phases}; expected at least 1")
    if not recording.tracks:
        return
    grid = Grid.of(recording)
    routes = RouteMemory(recording)
    start, end = recording.frame_range
    low, high = (int(start + part * (end - start)) for part in span)
    steps = round(HORIZON / grid.dt + 0.5)
    first = low + (LEAST_OBSERVED - 1) * grid.every
    # On the recording's own rows.
    first = start + -(-(first - start) // grid.every) * grid.every
    rows = grid.every // recording.frame_step
    between = max(1, rows // min(phases, rows)) * recording.frame_step
    for frame in range(first, high - LEAST_PREDICTED * grid.every + 1, between):
        yield from _moment(
            recording, grid, routes, frame, min(steps, (high - frame) // grid.every), agents
        )


def window_examples(
    recording: Recording, agents: int = AGENTS, span: tuple[float, float] = (0.0, 1.0)
) -> Iterator[Example]:
    """Yield an example of each interaction window, with the interacting agents only.

    Args:
        recording: with the agents.
        agents: places of a scene.
        span: part of the recording, by frames, that the moment and, where it ends early, all
            predicted steps lie in; observed steps may precede it.
    """
    start, end = recording.frame_range
    low, high = (start + part * (end - start) for part in span)
    grid = Grid.of(recording)
    for window in interaction_windows(recording):
        if low <= window.frame <= high - (grid.predicted * grid.every if span[1] < 1.0 else 0):
            yield example_of(window.history, window.truth, agents)


def _moment(
    recording: Recording, grid: Grid, routes: RouteMemory, frame: int, steps: int, agents: int
) -> Iterator[Example]:
    seen_from = frame - (LEAST_SEEN - 1) * grid.every
    names = [
        t.agent_id for t in recording.tracks if t.frames[0] <= seen_from and t.frames[-1] >= frame
    ]
    if not names:
        return
    window = observed_window(
        recording, names, frame - (grid.observed - 1) * grid.every, grid.observed, grid.every
    )
    later = recording.window(names, frame + grid.every, steps, grid.every).states[..., :2]
    seen = ~np.isnan(window.states).any(axis=2)
    counts = seen[-LEAST_OBSERVED:].all(axis=0) & ~np.isnan(later[:LEAST_PREDICTED]).any((0, 2))
    context = seen[-LEAST_SEEN:].all(axis=0) & ~counts
    ready = np.concatenate([np.flatnonzero(counts), np.flatnonzero(context)])
    known = routes.before(frame)
    routes_seen = Context(tuple(r.path for r in known), np.array([r.frequency for r in known]))
    for near, _ in near_groups(window.states[-1, ready, :2], int(counts.sum()), agents):
        group = ready[near]
        history = History(
            window.states[:, group],
            window.headings[:, group],
            tuple(window.kinds[i] for i in group),
            window.extents[group],
            grid.dt,
            routes_seen,
        )
        yield example_of(history, later[:, group], agents)


def simulated_examples(row: Row, agents: int = AGENTS) -> Iterator[Example]:
    """Of an episode as `generation` makes it, with the ego's noise on all agents' states."""
    scene = setting_of(row["place"]).make().scene
    count, steps, dt = row["players"], row["steps"], row["dt"]
    every = max(1, round(STEP_SECONDS / dt))
    states = np.array(row["states"]).reshape(steps + 1, count, 4)
    seen = observed_states(np.array(row["observations"]).reshape(steps, -1), row["ego"], count)
    first = (LEAST_OBSERVED - 1) * every
    for moment in range(first, steps + 1 - LEAST_PREDICTED * every, every):
        rows = range(max(moment % every, moment - 7 * every), moment + 1, every)
        plain = history_of(scene, tuple(seen[min(k, steps - 1)] for k in rows))
        ahead = range(moment + every, steps + 1, every)
        yield example_of(replace(plain, dt=every * dt), states[list(ahead), :, :2], agents)
