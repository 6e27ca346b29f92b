"""Prediction on recordings: every registered predictor on every window, one row each."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from agents.registry import make_predictor
from evaluation.execution.compilation import until_forgotten
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.trajectory import (
    best_displacement,
    displacement,
    displacement_until,
    missed,
    negative_log_likelihood,
)
from evaluation.windows import interaction as prediction_window
from evaluation.windows.interaction import (
    PredictionWindow,
    connected,
    cut,
    interaction_windows,
    split_of,
)
from evaluation.windows.table import WINDOW, with_windows, write_windows
from foresight_env.datasets import Recording, open_recording, recordings_below
from foresight_env.games.footprints import Footprint, Motion, least_gap
from foresight_env.games.kinds import body_radius, is_vehicle, kind_of

KEY = (*WINDOW, "predictor", "settings")
SECONDS = (1.0, 2.0, 3.0, 4.0)
"""Times at which errors are told."""
RULE = (
    "STEP_SECONDS",
    "OBSERVED_SECONDS",
    "PREDICTED_SECONDS",
    "NEAR",
    "LEAST_OBSERVED",
    "LEAST_PREDICTED",
    "MOST_AGENTS",
)
SCHEMA = 2
"""Changes with the columns of a row: folders of before are refused, not mixed up."""
MODES = 5
"""Of how many of the most_likely futures the best counts, as in most benchmarks (nuScenes)."""
STANDING = 0.05
"""Who moves less than this in a step keeps its heading, m."""

Place = tuple[str, str | None]
"""A directory or file, and the recording's name in it."""


@lru_cache(maxsize=8)
def _recording(place: Place) -> Recording:
    return open_recording(place[0], recording=place[1])


def footprint(kind: str, extent: Float[np.ndarray, "2"]) -> Footprint:
    """What an agent covers: a box for vehicles, of usual size where none is stated, else a disc."""
    if not is_vehicle(kind):
        return Footprint(radius=body_radius(kind))
    usual = kind_of(kind)
    stated = np.where(extent > 0.0, extent, (usual.length, usual.width))
    return Footprint(float(stated[0]), float(stated[1]))


def overlaps(history: History, positions: Float[np.ndarray, "P N 2"]) -> int:
    """Pairs whose footprints overlap at a step or on the way to it; vehicles head where they go.

    Steps that lead to NaN do not count. Boxes turn evenly during a step.
    """
    shapes = [footprint(k, e) for k, e in zip(history.kinds, history.extents, strict=True)]
    tracks = [_motions(history, i, positions[:, i]) for i in range(len(shapes))]
    return sum(
        any(
            not (np.isnan(a.end).any() or np.isnan(b.end).any())
            and least_gap(shapes[i], shapes[j], a, b) < 0.0
            for a, b in zip(tracks[i], tracks[j], strict=True)
        )
        for i, j in combinations(range(len(shapes)), 2)
    )


def _motions(history: History, agent: int, path: Float[np.ndarray, "P 2"]) -> list[Motion]:
    """The agent's steps, from where it was seen last."""
    last = history.seen(agent)[-1]
    place, velocity = history.states[last, agent, :2], history.states[last, agent, 2:]
    heading = float(history.headings[last, agent])
    if np.isnan(heading):
        heading = float(np.arctan2(velocity[1], velocity[0]))
    found = []
    for after in path:
        way = after - place
        aim = float(np.arctan2(way[1], way[0])) if np.hypot(*way) > STANDING else heading
        turn = float(np.mod(aim - heading + np.pi, 2.0 * np.pi) - np.pi)
        found.append(Motion(place, after, heading, turn))
        place, heading = after, heading + turn
    return found


def judged(window: PredictionWindow, forecast: Forecast) -> Row:
    """Return a forecast's metrics, of the most likely future unless the name says otherwise."""
    path, truth, present = forecast.most_likely, window.truth, window.present
    history = window.history
    average, final = displacement(path, truth, present)
    row: Row = {
        "average_error": average,
        "final_error": final,
        "missed": int(missed(path, truth, present).sum()),
        "overlaps": overlaps(history, np.where(present[..., None], path, np.nan)),
        "overlaps_recorded": overlaps(history, truth),
        "fallback": forecast.fallback,
        "agent_errors": [
            displacement(path[:, [i]], truth[:, [i]], present[:, [i]])[0]
            for i in range(len(window.agents))
        ],
        "gamma": [] if forecast.gamma is None else forecast.gamma.tolist(),
    }
    best = best_displacement(forecast.positions, forecast.probabilities, truth, present, MODES)
    row["best_average_error"], row["best_final_error"] = best
    row["nll"] = None
    if forecast.covariance is not None:
        row["nll"] = negative_log_likelihood(
            forecast.positions, forecast.probabilities, forecast.covariance, truth, present
        )
    for seconds in SECONDS:
        until = displacement_until(path, truth, present, history.dt, seconds)
        row[f"ade_{seconds:g}"], row[f"fde_{seconds:g}"] = until
    return row


@until_forgotten
def warm_up(predictor: str, kinds: tuple[str, ...], observed: int, steps: int, dt: float) -> None:
    """Compile in this process what a prediction needs, so that latencies are those of running."""
    states = np.zeros((observed, len(kinds), 4))
    states[:, :, 1] = 10.0 * np.arange(len(kinds))
    states[:, :, 0] = dt * np.arange(observed)[:, None]
    states[:, :, 2] = 1.0
    blank = np.full((observed, len(kinds)), np.nan)
    history = History(states, blank, kinds, np.full((len(kinds), 2), np.nan), dt)
    make_predictor(predictor).predict(history, steps)


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
    window = cut(_recording(place), agents.split(","), frame)
    history, steps = window.history, len(window.truth)
    warm_up(predictor, history.kinds, len(history.states), steps, history.dt)
    begin = time.perf_counter()
    forecast = make_predictor(predictor).predict(history, steps)
    seconds = time.perf_counter() - begin
    return {**judged(window, forecast), "seconds": seconds}


def study(
    folder: str | Path,
    data: str | Path,
    predictors: Sequence[str],
    *,
    split: str = "all",
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder` on every recording below `data` and return its rows.

    `split`: "development", "test" or "all". Windows that the folder has already are not run again.
    Raises `RecordingError` for bad data, `ValueError` where nobody interacts.
    """
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
            content = _digest(recording)
            found += [(w, recording.source, content, place) for w in interaction_windows(recording)]
    if not found:
        raise ValueError(
            f"--data: nobody interacts in the recordings of {data} (split {split}: "
            f"{', '.join(names) or 'none'})"
        )
    rule = {name: getattr(prediction_window, name) for name in RULE} | {"schema": SCHEMA}
    store = Store(folder, "prediction", rule, KEY, fresh=fresh)
    trials: list[Trial] = []
    windows: list[Row] = []
    groups = connected([w for w, *_ in found])
    for (window, source, content, place), group in zip(found, groups, strict=True):
        identity = {
            "recording": window.recording,
            "content": content,
            "frame": window.frame,
            "agents": ",".join(window.agents),
        }
        windows.append(
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
    write_windows(store.folder, windows)
    rows = run_trials(run_window, trials, store, workers=workers, label="windows", chunk=32)
    return with_windows(store.folder, rows)


def _digest(recording: Recording) -> str:
    """Tells recordings of the same name apart."""
    found = hashlib.sha256()
    for track in recording.tracks:
        found.update(track.agent_id.encode())
        found.update(np.ascontiguousarray(track.position).tobytes())
    return found.hexdigest()[:16]
