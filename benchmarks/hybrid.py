"""`hybrid-game`: which games are solved, how long a prediction takes."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from agents.hybrid.predictor import HybridPredictor
from agents.interfaces.predictor import History
from benchmarks.report import Arguments, Result, TableRow
from evaluation.windows.complete import complete_agents, histories_at
from evaluation.windows.interaction import split_of
from foresight_env.datasets import Recording, open_recording, recordings_below

TITLE = "Games of hybrid-game"
MOST_HISTORIES = 100
"""Of a recording, evenly chosen."""
QUICK_HISTORIES = 5
STEPS = 12
SIZES = {"2": (1, 2), "3, 4": (3, 4), "5 to 8": (5, 8)}
"""Rows: least and largest number of agents."""


def histories(recording: Recording, most: int) -> list[History]:
    """Histories of moments with complete agents, evenly chosen."""
    complete = list(complete_agents(recording).items())
    chosen = np.unique(np.linspace(0, len(complete) - 1, min(most, len(complete))).astype(int))
    found = []
    for k in chosen:
        frame, agents = complete[k]
        found.append(next(histories_at(recording, frame, agents)).history)
    return found


def rows(seen: Sequence[History]) -> list[TableRow]:
    """A line for each size of a game."""
    predictor = HybridPredictor()
    made: dict[str, list[tuple[float, float, float]]] = {name: [] for name in SIZES}
    warm: set[int] = set()
    for history in seen:
        count = len(history.kinds)
        if count not in warm:
            predictor.predict(history, STEPS)
            warm.add(count)
        begin = time.perf_counter()
        predictor.predict(history, STEPS)
        seconds = time.perf_counter() - begin
        explained = predictor.explain(history)
        for name, (least, largest) in SIZES.items():
            if least <= count <= largest:
                meet = explained.interact.any(axis=1).mean()
                made[name].append((explained.solved_share, float(meet), seconds))
    found = []
    for name, values in made.items():
        if values:
            solved, meet, seconds = np.array(values).T
            found.append(
                {
                    "agents": name,
                    "histories": len(values),
                    "games solved [%]": 100.0 * float(solved.mean()),
                    "agents that meet one [%]": 100.0 * float(meet.mean()),
                    "prediction, median [ms]": 1e3 * float(np.median(seconds)),
                    "p99 [ms]": 1e3 * float(np.quantile(seconds, 0.99)),
                }
            )
    return found


def run(arguments: Arguments) -> list[Result]:
    """The study on development recordings; without data it says that it was skipped."""
    note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
    found: list[TableRow] = []
    if arguments.data is not None:
        most = QUICK_HISTORIES if arguments.quick else MOST_HISTORIES
        seen: list[History] = []
        for directory, name in recordings_below(arguments.data):
            recording = open_recording(str(directory), recording=name)
            if split_of(recording.name) == "development" and recording.tracks:
                seen += histories(recording, most)
        found = rows(seen)
        note = (
            "Moments of development recordings, all agents near each other; every prediction "
            "solves 20 games. One is solved where no gradient exceeds `TOLERANCE` after the fixed "
            "number of Newton steps; else the network's proposal is the future."
        )
    return [Result(TITLE, note, found).show(arguments.console)]
