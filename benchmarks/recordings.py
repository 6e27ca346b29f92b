"""Recorded crossings: three ways to predict, over all crossing pairs of every file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import Result, Row, Setting
from evaluation.recorded import METHODS, EncounterError, Forecast, encounters, forecast
from evaluation.statistics import mean_interval

TITLE = "Recorded crossings"
QUICK_PAIRS = 4
"""Pairs per file with `--quick`."""


def files_below(folder: Path) -> list[Path]:
    """DUT and UCY recordings anywhere below the folder."""
    return sorted([*folder.rglob("*_ped_filtered.csv"), *folder.rglob("*obsmat.txt")])


def line(name: str, forecasts: Sequence[Sequence[Forecast]]) -> list[Row]:
    """One row per method: errors, and how often it beats the two baselines."""
    average = np.array([[f.average_error for f in each] for each in forecasts])
    final = np.array([[f.final_error for f in each] for each in forecasts])
    rows: list[Row] = []
    for k, method in enumerate(METHODS):
        mean, end = mean_interval(average[:, k]), mean_interval(final[:, k])
        row: Row = {
            "recording": name,
            "pairs": str(len(forecasts)),
            "method": method,
            "ADE [m]": f"{mean.mean:.3f} [{mean.low:.3f}, {mean.high:.3f}]",
            "FDE [m]": f"{end.mean:.3f} [{end.low:.3f}, {end.high:.3f}]",
        }
        for title, other in (
            ("won against constant velocity", "constant velocity"),
            ("won against gamma = 1", "farsighted"),
        ):
            won = average[:, k] < average[:, METHODS.index(other)]
            row[title] = "-" if method == other else f"{won.mean():.0%}"
        row["fell back"] = sum(not each[k].solved for each in forecasts)
        rows.append(row)
    return rows


def run(setting: Setting) -> list[Result]:
    """The study; without data it says that it was skipped."""
    if setting.data is None:
        note = "Skipped: recorded data are not shipped; give their folder with `--data DIR`."
        return [Result(TITLE, note, []).show(setting.console)]
    files = files_below(setting.data)
    if not files:
        raise ValueError(f"--data: no *_ped_filtered.csv or *obsmat.txt below {setting.data}")
    rows: list[Row] = []
    everything: list[list[Forecast]] = []
    without: list[str] = []
    for file in files:
        try:
            chosen = encounters(file, count=QUICK_PAIRS if setting.quick else None)
        except EncounterError:
            without.append(file.stem)
            continue
        with setting.console.status(f"{file.stem}: {len(chosen)} pairs"):
            found = [[forecast(e, m) for m in METHODS] for e in chosen]
        rows += line(chosen[0].recording, found)
        everything += found
    if everything:
        rows += line("all", everything)
    note = (
        "Each pair is observed until 1 s before its crossing, the next 4 s are predicted; means "
        "with 95 % intervals. Won: share of pairs with the smaller ADE. "
        + ("Closest pairs only. " if setting.quick else "All crossing pairs. ")
        + (f"Without a usable pair: {', '.join(without)}." if without else "")
    )
    return [Result(TITLE, note, rows).show(setting.console)]
