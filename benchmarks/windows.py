"""A car and a pedestrian who cross, in every DUT clip: the published and the realistic game."""

from __future__ import annotations

from pathlib import Path

from benchmarks.report import Arguments, Result, TableRow
from evaluation.studies.junction_comparison import compare
from evaluation.windows.intersection import Case, Choice, load
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


def rows_of(case: Case, clip: str, parameters: str) -> list[TableRow]:
    """A line per game and method."""
    return [
        {
            "clip": clip,
            "agents": ", ".join(case.agents),
            "steps": len(case.states),
            "free": parameters if c.game == "published" else "",
            "game": c.game,
            "method": c.method,
            "fit, squared": c.fit_squared,
            "prediction, ADE [m]": c.average_error,
            "FDE [m]": c.final_error,
        }
        for c in compare(case, len(case.states) // 2, parameters)
        if parameters == "goals" or c.game == "published"
    ]


def run(arguments: Arguments) -> list[Result]:
    """The study; without data it says that it was skipped. `quick` has 2 clips."""
    if arguments.data is None:
        note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
        return [Result(TITLE, note, []).show(arguments.console)]
    files = sorted(arguments.data.rglob("*_traj_ped_filtered.csv"))
    if not files:
        raise ValueError(f"--data: no *_ped_filtered.csv below {arguments.data}")
    rows: list[TableRow] = []
    for file in files[: 2 if arguments.quick else None]:
        clip = file.name.removesuffix("_traj_ped_filtered.csv")
        choice = window(file.parent, clip)
        if choice is not None:
            for parameters in PARAMETERS:
                rows += rows_of(load(choice), clip, parameters)
    note = (
        "The closest crossing of a car and a pedestrian of each DUT clip, every sixth frame. "
        "Fit: squared error of the whole fitted window against the recorded one, full states, no "
        "noise added. Prediction: of the second half, from the first. Free in the published game: "
        "goals alone, or weights and distances too."
    )
    return [Result(TITLE, note, rows).show(arguments.console)]
