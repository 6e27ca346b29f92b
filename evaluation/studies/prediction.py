"""Prediction on recordings: every registered predictor on every window, one row each."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from agents.interfaces.predictor import History
from agents.registry import make_predictor
from evaluation.execution.compilation import until_forgotten
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.prediction import judged
from evaluation.windows import interaction as prediction_window
from evaluation.windows.interaction import (
    PredictionWindow,
    connected,
    cut,
    interaction_windows,
    split_of,
)
from evaluation.windows.nearby import nearby_windows
from evaluation.windows.table import WINDOW, with_windows, write_windows
from foresight_env.datasets import Recording, RouteMemory, open_recording, recordings_below

KEY = (*WINDOW, "predictor", "settings")
RULE = (
    "STEP_SECONDS",
    "OBSERVED_SECONDS",
    "PREDICTED_SECONDS",
    "NEAR",
    "LEAST_OBSERVED",
    "LEAST_PREDICTED",
    "MOST_AGENTS",
)

RULES: dict[str, Callable[[Recording], tuple[PredictionWindow, ...]]] = {
    "interacting": interaction_windows,
    "all": nearby_windows,
}
"""How windows are chosen."""

Place = tuple[str, str | None]
"""A directory or file, and the recording's name in it."""


@lru_cache(maxsize=8)
def _recording(place: Place) -> Recording:
    return open_recording(place[0], recording=place[1])


@lru_cache(maxsize=8)
def _routes(place: Place) -> RouteMemory:
    return RouteMemory(_recording(place))


@until_forgotten
def warm_up(
    predictor: str,
    kinds: tuple[str, ...],
    observed: int,
    steps: int,
    dt: float,
    weights: str | None = None,
) -> None:
    """Compile in this process what a prediction needs, so that latencies are those of running."""
    states = np.zeros((observed, len(kinds), 4))
    states[:, :, 1] = 10.0 * np.arange(len(kinds))
    states[:, :, 0] = dt * np.arange(observed)[:, None]
    states[:, :, 2] = 1.0
    blank = np.full((observed, len(kinds)), np.nan)
    history = History(states, blank, kinds, np.full((len(kinds), 2), np.nan), dt)
    make_predictor(predictor, weights).predict(history, steps)


def run_window(
    recording: str,
    content: str,
    frame: int,
    agents: str,
    predictor: str,
    settings: str,
    place: Place,
) -> Row:
    """One predictor's row for one window; the texts identify it in the store."""
    window = cut(_recording(place), agents.split(","), frame, _routes(place))
    history, steps = window.history, len(window.truth)
    warm_up(predictor, history.kinds, len(history.states), steps, history.dt)
    if history.context.routes:  # which may lead to different programs
        make_predictor(predictor).predict(history, steps)
    begin = time.perf_counter()
    forecast = make_predictor(predictor).predict(history, steps)
    seconds = time.perf_counter() - begin
    return {**judged(history, window.truth, forecast), "seconds": seconds}


def study(
    folder: str | Path,
    data: str | Path,
    predictors: Sequence[str],
    *,
    split: str = "all",
    windows: str = "interacting",
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder` on every recording below `data` and return its rows.

    `split`: "development", "test" or "all". `windows`: "interacting", of agents whose paths cross
    (`windows.interaction`), or "all" that move (`windows.nearby`). Windows that the folder has
    already are not run again. Raises `RecordingError` for bad data, `ValueError` where there is no
    window.
    """
    if windows not in RULES:
        raise ValueError(f"windows: is {windows!r}; expected {' or '.join(RULES)}")
    if split not in ("development", "test", "all"):
        raise ValueError(f"split: is {split!r}; expected development, test or all")
    settings = {name: fingerprint(make_predictor(name)) for name in predictors}
    found: list[tuple[PredictionWindow, str, str, Place]] = []
    names = []
    for directory, name in recordings_below(data):
        place = (str(directory), name)
        recording = _recording(place)
        if split in ("all", split_of(recording.name)):
            names.append(recording.name)
            content = digest_of(recording)
            found += [(w, recording.source, content, place) for w in RULES[windows](recording)]
    if not found:
        raise ValueError(
            f"--data: no window in the recordings of {data} (windows {windows}, split {split}: "
            f"{', '.join(names) or 'none'})"
        )
    rule = {name: getattr(prediction_window, name) for name in RULE} | {"windows": windows}
    store = Store(folder, "prediction", rule, KEY, fresh=fresh)
    trials: list[Trial] = []
    described: list[Row] = []
    groups = connected([w for w, *_ in found])
    for (window, source, content, place), group in zip(found, groups, strict=True):
        identity = {
            "recording": window.recording,
            "content": content,
            "frame": window.frame,
            "agents": ",".join(window.agents),
        }
        described.append(
            {
                **identity,
                "source": source,
                "split": split_of(window.recording),
                "kinds": list(window.history.kinds),
                "observed": window.seen_steps,
                "group": group,
            }
        )
        trials += [
            {**identity, "predictor": name, "settings": settings[name], "place": place}
            for name in predictors
        ]
    write_windows(store.folder, described)
    rows = run_trials(
        run_window,
        trials,
        store,
        workers=workers,
        label="windows",
        chunk=32,
        programs=("predictor",),
    )
    return with_windows(store.folder, rows)


def digest_of(recording: Recording) -> str:
    """Digest of a recording, which distinguishes recordings of the same name."""
    found = hashlib.sha256()
    for track in recording.tracks:
        found.update(track.agent_id.encode())
        found.update(np.ascontiguousarray(track.position).tobytes())
    return found.hexdigest()[:16]
