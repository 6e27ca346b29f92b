"""Training data of `hybrid-game`: recordings or episodes, without those for tests.

Not both: then recordings are predicted worse (docs/measurements.md, "A network and a game").
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from agents.hybrid.loss import Example
from agents.hybrid.strategies import GAME_BASIS
from agents.learned.features import AGENTS
from evaluation.training.examples import LONG, VALIDATION
from evaluation.training.generation import episodes_in
from evaluation.training.hybrid import Fold, TrainingData
from evaluation.training.hybrid_examples import (
    recorded_examples,
    simulated_examples,
    stacked,
    window_examples,
)
from evaluation.windows.eth_ucy import others, read_scene_file, scene_files, scene_of
from evaluation.windows.interaction import split_of
from foresight_env.datasets import Recording, open_recording, recordings_below

PARTS = {"train": (0.0, 0.85), "validation": (0.85, 1.0)}
"""Of a long recording's frames."""
FOLDS = 3
"""Of recordings, each held out once from a training that only calibrates."""
PHASES = 2
"""Moments per step that recordings with rows between are learned from: those of DUT and inD."""
WINDOWS = 2
"""How often windows in which agents interact are learned from, besides all moments."""
PLAYING = 4
"""Places for agents in the examples of the second stage: games with fewer agents are cheaper."""
MOST_PLAYED = 1500
"""Examples of the second stage, chosen at random of those in which agents come close; windows in
which agents interact are among them `WINDOWS` times more."""
CLOSE = 1.0
"""Distance of the surfaces of bodies in straight motion below which agents come close, m."""

TWICE = 0.05
"""Agents that stay nearer to each other than this are one agent, m."""


def leave_one_out(data: Path, held_out: str) -> TrainingData:
    """Return examples of all scenes of the ETH/UCY protocol but one.

    Raises:
        RecordingError: a scene's file is missing.
    """
    recordings = others(data, held_out)

    def examples(part: str, places: int) -> Iterable[Example]:
        for recording in recordings:
            yield from recorded_examples(recording, places, PARTS[part], PHASES)

    return _both(examples)


def recorded(data: Path) -> TrainingData:
    """Return examples of the recordings that settings are chosen on.

    Raises:
        ValueError: there are none.
    """
    recordings = [r for r in _recordings(data) if split_of(r.name) == "development"]

    def of(recording: Recording, part: str, places: int) -> Iterator[Example]:
        start, end = recording.frame_range
        span = PARTS[part]
        if (end - start) / recording.rate <= LONG:
            if (part == "validation") != (recording.name in VALIDATION):
                return
            span = (0.0, 1.0)
        yield from recorded_examples(recording, places, span, PHASES)
        if part == "train":
            windows = list(window_examples(recording, places, span))
            yield from WINDOWS * windows

    def examples(part: str, places: int) -> Iterable[Example]:
        for recording in recordings:
            yield from of(recording, part, places)

    there = [r for r in recordings if any(True for _ in of(r, "train", AGENTS))]
    windows = [list(window_examples(r)) for r in there]

    def fold(k: int) -> Fold:
        rest = (r for i, r in enumerate(there) if i % FOLDS != k)
        numbers = np.repeat(np.arange(len(windows[k::FOLDS])), list(map(len, windows[k::FOLDS])))
        return Fold(
            stacked([e for r in rest for e in of(r, "train", AGENTS)]),
            stacked([e for made in windows[k::FOLDS] for e in made]),
            numbers,
        )

    enough = len(there) >= FOLDS and all(any(windows[k::FOLDS]) for k in range(FOLDS))
    folds = tuple(fold(k) for k in range(FOLDS)) if enough else ()
    return _both(examples)._replace(folds=folds)


def simulated(episodes: Sequence[Path]) -> TrainingData:
    """Return examples of episodes.

    Raises:
        ValueError: there are none.
    """

    def examples(part: str, places: int) -> Iterable[Example]:
        for folder in episodes:
            for row in episodes_in(folder / part, part):
                yield from simulated_examples(row, places)

    return _both(examples)


def _recordings(data: Path) -> list[Recording]:
    found = []
    for directory, name in recordings_below(data):
        scene = scene_of(name or "")
        recording = open_recording(str(directory), recording=name)
        if scene is not None:
            # With its own frame rate.
            recording = next(
                r
                for path in scene_files(directory, scene)
                if (r := read_scene_file(str(path), scene)).name == recording.name
            )
        found.append(recording)
    return found


def _both(examples: Callable[[str, int], Iterable[Example]]) -> TrainingData:
    made = [_stack(examples(part, places)) for part in PARTS for places in (AGENTS, PLAYING)]
    proposing, playing, judged, judged_playing = made
    return TrainingData(
        proposing,
        some(playing, close(playing), MOST_PLAYED),
        judged,
        some(judged_playing, close(judged_playing), MOST_PLAYED // 5),
    )


def _stack(examples: Iterable[Example]) -> Example:
    found = list(examples)
    if not found:
        raise ValueError("--episodes, --data: hold nothing to learn from")
    return stacked(found)


def close(examples: Example) -> Bool[np.ndarray, "S"]:
    """Return in which examples two agents come close if both go straight on.

    Not those in which an agent was recorded twice: a game between the two has no solution.
    """
    frames, bodies = examples.scene.frames, examples.scene.bodies
    path = _straight(np.asarray(frames.place), np.asarray(frames.velocity))
    distance = np.linalg.norm(path[:, :, None] - path[:, None], axis=-1)
    gap = distance.min(axis=-1)
    radius = np.asarray(bodies.half_length)
    gap = gap - radius[:, :, None] - radius[:, None]
    there = np.asarray(bodies.there)
    pairs = there[:, :, None] & there[:, None] & ~np.eye(there.shape[1], dtype=bool)
    twice = (pairs & (distance.max(axis=-1) < TWICE)).any(axis=(1, 2))
    return np.asarray((pairs & (gap < CLOSE)).any(axis=(1, 2)) & ~twice)


def _straight(
    place: Float[np.ndarray, "S A 2"], velocity: Float[np.ndarray, "S A 2"]
) -> Float[np.ndarray, "S A T 2"]:
    return place[:, :, None] + GAME_BASIS.times[:, None] * velocity[:, :, None]


def some(examples: Example, allowed: Bool[np.ndarray, "S"], count: int) -> Example:
    """Return at most so many of the allowed examples, or of all where none is."""
    chosen = np.flatnonzero(allowed) if allowed.any() else np.arange(len(allowed))
    chosen = np.sort(np.random.default_rng(0).permutation(chosen)[:count])
    found: Example = jax.tree.map(lambda values: values[chosen], examples)
    return found
