"""Predictions on recordings: every registered predictor, development and test clips separately."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from typing import Any

from agents import PREDICTORS
from benchmarks.report import Arguments, Result, TableRow
from evaluation.reports.prediction import by_class, differences, over_time, summary
from evaluation.studies.prediction import study

TITLE = "Predictions on recordings"
QUICK = ("constant-velocity", "constant-turn-rate")
"""Predictors with `--quick`."""
TABLES: tuple[tuple[str, Callable[[Sequence[dict[str, Any]]], list[TableRow]], str], ...] = (
    (
        TITLE,
        summary,
        "Every window of `evaluation.windows.interaction`'s rule: agents whose paths cross, who "
        "come within 5 m, up to 3 s given and 4 s predicted. Means over windows. Missed: agents "
        "predicted more than 2 m off at the last step they are there. Predicted collisions: pairs "
        "whose footprints overlap (recorded: in the recording). Settings were chosen on the "
        "development recordings.",
    ),
    (f"{TITLE}: errors over time", over_time, "Means over windows."),
    (
        f"{TITLE}: on the same windows",
        differences,
        "Mean differences, 95 % bootstrap intervals over groups of windows that share agents.",
    ),
    (f"{TITLE}: by class of agent", by_class, "Means over agents and windows."),
)


def run(arguments: Arguments) -> list[Result]:
    """The study; without data it says that it was skipped."""
    if arguments.data is None:
        note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
        return [Result(TITLE, note, []).show(arguments.console)]
    with tempfile.TemporaryDirectory() as folder:
        rows = study(folder, arguments.data, QUICK if arguments.quick else tuple(PREDICTORS))
    return [Result(title, note, make(rows)).show(arguments.console) for title, make, note in TABLES]
