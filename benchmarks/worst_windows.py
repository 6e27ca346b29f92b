"""Windows in which `hybrid-game` loses most against constant velocity, and how it is wrong."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents import make_predictor
from benchmarks.report import Arguments, Result, TableRow
from evaluation.metrics.trajectory import displacement
from evaluation.windows.interaction import PredictionWindow, interaction_windows, split_of
from foresight_env.datasets import open_recording, recordings_below

TITLE = "Where hybrid-game loses"
REFERENCE, JUDGED, ALONE = "constant-velocity", "hybrid-game", "hybrid-network"
WORST = 20
"""Windows in the table."""
QUICK_WINDOWS = 5
"""Of a recording."""
STANDING = 0.3
"""Speed below which an agent stands, m/s."""


class Loss(NamedTuple):
    """A window in which straight motion is better."""

    window: PredictionWindow
    difference: float
    """Of mean displacements, m."""
    errors: tuple[float, float]
    """Mean displacement of `JUDGED` and of `REFERENCE`, m."""
    agent: int
    """Index of the one that loses most."""
    paths: dict[str, Float[np.ndarray, "P N 2"]]
    """By predictor."""


def losses(windows: list[PredictionWindow]) -> list[Loss]:
    """Return all windows, the greatest loss first."""
    found = []
    predictors = {name: make_predictor(name) for name in (REFERENCE, JUDGED, ALONE)}
    for window in windows:
        steps = len(window.truth)
        paths = {n: p.predict(window.history, steps).most_likely for n, p in predictors.items()}
        present = window.present
        errors = {
            n: displacement(path, window.truth, present)[0]
            for n, path in paths.items()
        }  # fmt: skip
        each = [
            displacement(paths[JUDGED][:, [i]], window.truth[:, [i]], present[:, [i]])[0]
            - displacement(paths[REFERENCE][:, [i]], window.truth[:, [i]], present[:, [i]])[0]
            for i in range(len(window.agents))
        ]
        found.append(
            Loss(
                window,
                errors[JUDGED] - errors[REFERENCE],
                (errors[JUDGED], errors[REFERENCE]),
                int(np.argmax(each)),
                paths,
            )
        )
    return sorted(found, key=lambda loss: -loss.difference)


def row(loss: Loss) -> TableRow:
    """A line of the table, of the agent that loses most."""
    window, i = loss.window, loss.agent
    last = int(np.flatnonzero(window.present[:, i])[-1])
    now = window.history.seen(i)[-1]
    place, velocity = window.history.states[now, i, :2], window.history.states[now, i, 2:]
    speed = float(np.hypot(*velocity))
    along = velocity / speed if speed > 1e-6 else np.array([1.0, 0.0])
    axes = np.stack([along, [-along[1], along[0]]])
    off = axes @ (loss.paths[JUDGED][last, i] - window.truth[last, i])
    moved = axes @ (window.truth[last, i] - place)
    by_game = loss.paths[JUDGED][last, i] - loss.paths[ALONE][last, i]
    seconds = (last + 1) * window.history.dt
    return {
        "recording, frame": f"{window.recording}, {window.frame}",
        "agent": f"{window.history.kinds[i]} {window.agents[i]}",
        "ADE [m], constant velocity": "{:.2f}, {:.2f}".format(*loss.errors),
        "speed before, after [m/s]": f"{speed:.1f}, {float(np.hypot(*moved)) / seconds:.1f}",
        "it went": told(moved - np.array([speed * seconds, 0.0]), speed),
        "predicted": wrong(off),
        "moved by the game [m]": float(np.hypot(*by_game)),
    }


def told(departure: Float[np.ndarray, "2"], speed: float) -> str:
    """Words for a departure (m) from straight motion, along and across an agent's way."""
    along, across = departure
    if np.hypot(along, across) < 0.5:
        return "straight on"
    if abs(across) > abs(along):
        return f"{abs(across):.1f} m to the {'left' if across > 0.0 else 'right'}"
    if along > 0.0:
        return f"{along:.1f} m further" if speed > STANDING else f"{along:.1f} m, from standing"
    return f"{-along:.1f} m less far"


def wrong(off: Float[np.ndarray, "2"]) -> str:
    """How a forecast differs from the truth at the end, along and across the agent's way."""
    along, across = off
    if abs(across) > abs(along):
        return f"{abs(across):.1f} m too far {'left' if across > 0.0 else 'right'}"
    return f"{abs(along):.1f} m too {'far' if along > 0.0 else 'short'}"


def run(arguments: Arguments) -> list[Result]:
    """The worst windows of the recordings for tests."""
    windows: list[PredictionWindow] = []
    if arguments.data is not None:
        for directory, name in recordings_below(arguments.data):
            recording = open_recording(str(directory), recording=name)
            if split_of(recording.name) == "test" and recording.tracks:
                seen = interaction_windows(recording)
                windows += seen[:QUICK_WINDOWS] if arguments.quick else seen
    found = losses(windows)
    note = (
        f"The {WORST} of {len(found)} windows of test recordings with the greatest difference, by "
        "the agent that loses most; the last known step counts. Straight motion is better in "
        f"{np.mean([loss.difference > 0.0 for loss in found]) if found else 0.0:.0%} of all."
    )
    return [Result(TITLE, note, [row(loss) for loss in found[:WORST]]).show(arguments.console)]
