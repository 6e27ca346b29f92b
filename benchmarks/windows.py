"""A car and a pedestrian who cross, in every DUT clip, fitted with the intersection's game."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.report import Result, Row, Setting
from evaluation.studies.intersection import METHODS, by_agent, fit, observe, predict, straight
from evaluation.windows.intersection import Case, Choice, difference, load
from foresight_env.datasets import closest_crossings, open_recording

TITLE = "Recorded windows at an intersection"
EVERY = 6
BEFORE, STEPS = 3.0, 21
"""Windows begin so long before the first agent crosses (s) or when both are there, and have so many
steps or as long as both stay."""
PARAMETERS = ("goals", "all")


def window(folder: Path, clip: str) -> Choice | None:
    """The closest crossing of a car and a pedestrian in a clip; None where there is none."""
    recording = open_recording(folder, recording=clip)
    for crossing in closest_crossings(recording):
        if crossing.kinds.count("pedestrian") != 1:
            continue
        frames = [recording.track(agent).frames for agent in crossing.agents]
        begin = round((crossing.times[0] - BEFORE) * recording.rate)
        first = max(int(frames[0][0]), int(frames[1][0]), begin)
        last = min(int(frames[0][-1]), int(frames[1][-1]), first + EVERY * (STEPS - 1))
        choice = Choice(str(folder), crossing.agents, (first, last), EVERY, clip)
        try:
            load(choice)
        except ValueError:
            continue  # too short
        return choice
    return None


def row(case: Case, clip: str, parameters: str) -> Row:
    """Errors of one window."""
    steps = len(case.states)
    errors = {}
    for method in METHODS:
        if method == "constant-velocity":
            states = straight(case, observe(case, "full", 0.0, 0, steps))
        else:
            states = by_agent(fit(case, "full", 0.0, 0, method, parameters))
        errors[method] = float(np.sum(difference(case, states) ** 2))
    predicted = predict(case, steps // 2, parameters)
    return {
        "clip": clip,
        "agents": ", ".join(case.agents),
        "steps": steps,
        "free": parameters,
        **{f"error, {name}": value for name, value in errors.items()},
        "ratio to gamma = 1": errors["infer-gamma"] / errors["assume-gamma-1"],
        **{f"ADE, {p.method}": p.average_error for p in predicted},
    }


def run(setting: Setting) -> list[Result]:
    """The study; without data it says that it was skipped. `quick` has 2 clips."""
    if setting.data is None:
        note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
        return [Result(TITLE, note, []).show(setting.console)]
    files = sorted(setting.data.rglob("*_traj_ped_filtered.csv"))
    if not files:
        raise ValueError(f"--data: no *_ped_filtered.csv below {setting.data}")
    rows: list[Row] = []
    for file in files[: 2 if setting.quick else None]:
        clip = file.name.removesuffix("_traj_ped_filtered.csv")
        choice = window(file.parent, clip)
        if choice is not None:
            rows += [row(load(choice), clip, parameters) for parameters in PARAMETERS]
    note = (
        "The closest crossing of a car and a pedestrian of each DUT clip, every sixth frame. "
        "Errors: squared, of the whole fitted window against the recorded one, full states, no "
        "noise added. ADE (m): of the second half, predicted from the first. Free: goals alone, or "
        "weights and distances too."
    )
    return [Result(TITLE, note, rows).show(setting.console)]
