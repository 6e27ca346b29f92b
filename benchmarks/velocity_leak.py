"""Recorded velocities: positions that they derive from, and later positions that they leak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents import make_predictor
from benchmarks.report import Arguments, Result, TableRow
from evaluation.metrics.trajectory import displacement
from evaluation.windows.interaction import PredictionWindow, split_of
from evaluation.windows.nearby import nearby_windows
from foresight_env.datasets import Recording, Track, open_recording, recordings_below
from foresight_env.datasets.observed import past_velocities

TITLE = "Recorded velocities"
MOST_WINDOWS = 1000
"""Of a recording, evenly chosen."""
QUICK_WINDOWS = 50
LONGEST_LAG = 1.0
"""s."""
DIFFERENCES = ("backward", "central", "forward")


def differences(track: Track, rate: float) -> dict[str, np.ndarray]:
    """Distances (m/s) of the recorded velocities from differences of the positions around them."""
    if len(track.frames) < 3:
        return {name: np.zeros(0) for name in DIFFERENCES}
    steps = np.diff(track.position, axis=0) / np.diff(track.frames / rate)[:, None]
    before, after = steps[:-1], steps[1:]
    candidates = (before, 0.5 * (before + after), after)
    return {
        name: np.linalg.norm(track.velocity[1:-1] - found, axis=1)
        for name, found in zip(DIFFERENCES, candidates, strict=True)
    }


def lag(recording: Recording) -> float:
    """By how much (s) velocities lag behind central differences of positions, by least squares."""
    reach = max(1, round(LONGEST_LAG * recording.rate / recording.frame_step))
    squares = np.zeros(2 * reach + 1)
    for track in recording.tracks:
        count = len(track.frames)
        if count <= 2 * reach + 2:
            continue
        middle = np.gradient(track.position, track.frames / recording.rate, axis=0)
        inside = np.arange(reach + 1, count - reach - 1)
        for k in range(2 * reach + 1):
            away = track.velocity[inside] - middle[inside - (k - reach)]
            squares[k] += float(np.sum(away**2))
    rows = int(np.argmin(squares)) - reach
    return rows * recording.frame_step / recording.rate


def error(window: PredictionWindow, recording: Recording, *, past: bool) -> float:
    """ADE (m) of constant velocity from recorded velocities, or from those of past positions."""
    states = window.history.states.copy()
    for i, agent in enumerate(window.agents):
        track = recording.track(agent)
        row = int(np.searchsorted(track.frames, window.frame))
        found = track.velocity[row]
        if past:
            found = past_velocities(track, np.array([window.frame]), recording.rate)[0]
        states[-1, i, 2:] = found
    history = replace(window.history, states=states)
    forecast = make_predictor("constant-velocity").predict(history, len(window.truth))
    return displacement(forecast.most_likely, window.truth, window.present)[0]


def row(recording: Recording, most: int) -> TableRow:
    """One recording's line."""
    apart = [differences(track, recording.rate) for track in recording.tracks]
    windows = nearby_windows(recording)
    windows = windows[:: max(1, len(windows) // most)]
    recorded, past = (
        float(np.mean([error(w, recording, past=p) for w in windows])) for p in (False, True)
    )
    return {
        "recording": f"{recording.source} {recording.name}",
        "split": split_of(recording.name),
        "windows": len(windows),
        **{
            f"RMS distance from {name} differences [m/s]": float(
                np.sqrt(np.mean(np.concatenate([a[name] for a in apart]) ** 2))
            )
            for name in DIFFERENCES
        },
        "lag behind central differences [s]": lag(recording),
        "ADE of constant velocity, recorded velocities [m]": recorded,
        "from past positions [m]": past,
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; without data it says that it was skipped."""
    note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
    rows: list[TableRow] = []
    if arguments.data is not None:
        most = QUICK_WINDOWS if arguments.quick else MOST_WINDOWS
        for directory, name in recordings_below(arguments.data):
            recording = open_recording(str(directory), recording=name)
            if recording.tracks and nearby_windows(recording):
                rows.append(row(recording, most))
        note = (
            "Windows of `evaluation.windows.nearby`'s rule. A velocity that is the forward or the "
            "central difference contains the next position. Those of filters (DUT, inD) agree with "
            "none of the three and lag behind."
        )
    return [Result(TITLE, note, rows).show(arguments.console)]
