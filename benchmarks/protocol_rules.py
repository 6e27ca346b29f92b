"""Constant velocity on ETH/UCY by several rules: why published numbers differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from benchmarks.report import Arguments, Result, TableRow
from evaluation.windows.complete import (
    LEAST_AGENTS,
    OBSERVED,
    PREDICTED,
    complete_agents,
    step_frames,
)
from evaluation.windows.eth_ucy import SCENES, read_scene_file, scene_files
from foresight_env.datasets import Recording, RecordingError

TITLE = "Constant velocity on ETH/UCY by several rules"
LEAST_STEPS = 10
"""Of a window in the code of Schoeller et al. (RA-L 2020): `min_sequence_length`."""
AVERAGED = 3
"""Steps whose mean velocity is continued."""
Windows = list[Float[np.ndarray, "_ 2"]]
"""Positions (m) of one agent each, from the first observed step on."""


def protocol_windows(recording: Recording) -> Windows:
    """Agents of all windows of the protocol."""
    every = step_frames(recording)
    found = []
    for frame, agents in complete_agents(recording).items():
        if len(agents) >= LEAST_AGENTS:
            first = frame - (OBSERVED - 1) * every
            window = recording.window(agents, first, OBSERVED + PREDICTED, every)
            found += list(window.states[..., :2].swapaxes(0, 1))
    return found


def short_windows(recording: Recording) -> Windows:
    """Agents by the rule of Schoeller et al.'s code, whose windows may end early.

    Every 20 rows of an agent in the file, whatever the time between them; the last ones have more
    than `LEAST_STEPS`. An agent of up to 20 rows is one window, if it has `LEAST_STEPS`.
    """
    length = OBSERVED + PREDICTED
    found = []
    for track in recording.tracks:
        path = track.position
        if LEAST_STEPS <= len(path) <= length:
            found.append(path)
        elif len(path) > length:
            found += [path[i : i + length] for i in range(len(path) - LEAST_STEPS)]
    return found


def errors(windows: Windows, averaged: int = 1) -> tuple[float, float]:
    """ADE and FDE (m), means over agents; the mean velocity of the last steps is continued."""
    average, final = [], []
    for path in windows:
        now = path[OBSERVED - 1]
        velocity = (now - path[OBSERVED - 1 - averaged]) / averaged
        ahead = np.arange(1, len(path) - OBSERVED + 1)[:, None]
        gap = np.linalg.norm(now + ahead * velocity - path[OBSERVED:], axis=1)
        average.append(gap.mean())
        final.append(gap[-1])
    return float(np.mean(average)), float(np.mean(final))


def unsteadiness(windows: Windows, dt: float) -> float:
    """Median change of velocity between steps, m/s^2."""
    changes = [np.linalg.norm(np.diff(path, 2, axis=0), axis=1) for path in windows]
    return float(np.median(np.concatenate(changes))) / dt**2


def row(scene: str, recordings: Sequence[Recording]) -> dict[str, float | tuple[float, float]]:
    """One scene's numbers by column."""
    whole = [path for r in recordings for path in protocol_windows(r)]
    short = [path for r in recordings for path in short_windows(r)]
    dt = step_frames(recordings[0]) / SCENES[scene].rate
    return {
        "agents": len(whole),
        "this protocol": errors(whole),
        "futures of 2 to 12 steps, agents alone as well": errors(short),
        f"velocity of the last {AVERAGED} steps": errors(whole, AVERAGED),
        "median change of velocity [m/s^2]": unsteadiness(whole, dt),
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; without data it says that it was skipped."""
    note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
    rows: list[TableRow] = []
    found = {}
    if arguments.data is not None:
        try:
            for scene in SCENES:
                files = scene_files(arguments.data, scene)
                found[scene] = row(scene, [read_scene_file(str(f), scene) for f in files])
        except RecordingError as error:
            note, found = f"Skipped: {error.problem}.", {}
    if found:
        note = (
            "ADE / FDE in m. The second rule is that of the code of Schoeller et al. (RA-L 2020), "
            "who publish 0.39 / 0.83."
        )
        pairs = [name for name, value in found["eth"].items() if isinstance(value, tuple)]
        for scene, values in found.items():
            rows.append({"scene": scene, **{k: _cell(v) for k, v in values.items()}})
        means = {name: np.mean([v[name] for v in found.values()], axis=0) for name in pairs}
        rows.append(
            {
                "scene": "average",
                **{k: _cell(tuple(means[k])) if k in means else "" for k in found["eth"]},
            }
        )
    return [Result(TITLE, note, rows).show(arguments.console)]


def _cell(value: float | tuple[float, ...]) -> str | float:
    return f"{value[0]:.2f} / {value[1]:.2f}" if isinstance(value, tuple) else value
