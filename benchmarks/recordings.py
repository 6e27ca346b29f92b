"""Recorded crossings: three ways to predict, over all crossing pairs of every file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import Result, Row, Setting
from evaluation.recorded import METHODS, Encounter, EncounterError, Forecast, encounters, forecast
from evaluation.statistics import clustered_interval, mean_interval

TITLE = "Recorded crossings"
LEAST_GROUPS = 5
"""Groups of dependent pairs below which resampling them means nothing."""
QUICK_PAIRS = 4
"""Pairs per file with `--quick`."""


def files_below(folder: Path) -> list[Path]:
    """DUT and UCY recordings anywhere below the folder."""
    return sorted([*folder.rglob("*_ped_filtered.csv"), *folder.rglob("*obsmat.txt")])


def line(
    name: str, chosen: Sequence[Encounter], forecasts: Sequence[Sequence[Forecast]]
) -> list[Row]:
    """One row per method: errors, and how often it beats the two baselines."""
    average = np.array([[f.average_error for f in each] for each in forecasts])
    final = np.array([[f.final_error for f in each] for each in forecasts])
    rows: list[Row] = []
    for k, method in enumerate(METHODS):
        mean, end = mean_interval(average[:, k]), mean_interval(final[:, k])
        row: Row = {
            "recording": name,
            "pairs": str(len(forecasts)),
            "lead [s]": f"{np.median([e.lead for e in chosen]):.2f}",
            "history": f"{np.median([e.history for e in chosen]):.0f}",
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


def groups(chosen: Sequence[Encounter]) -> list[str]:
    """For each pair, the name of the set of pairs that it shares agents with, directly or not."""
    leader: dict[str, str] = {}

    def find(agent: str) -> str:
        while leader.setdefault(agent, agent) != agent:
            agent = leader[agent]
        return agent

    members = [[f"{e.recording} {a}" for a in e.interaction.agents] for e in chosen]
    for first, second in members:
        leader[find(first)] = find(second)
    return [find(first) for first, _ in members]


def paired(
    name: str, chosen: Sequence[Encounter], forecasts: Sequence[Sequence[Forecast]]
) -> list[Row]:
    """Foresight's ADE minus each baseline's; agents that appear in several pairs stay together."""
    average = np.array([[f.average_error for f in each] for each in forecasts])
    clusters = groups(chosen)
    rows: list[Row] = []
    for other in ("farsighted", "constant velocity"):
        difference = average[:, METHODS.index("foresight")] - average[:, METHODS.index(other)]
        interval = clustered_interval(difference, clusters)
        rows.append(
            {
                "recording": name,
                "pairs": str(len(chosen)),
                "groups": str(len(set(clusters))),
                "foresight minus": other,
                "ADE [m]": f"{interval.mean:+.3f} "
                + (
                    f"[{interval.low:+.3f}, {interval.high:+.3f}]"
                    if len(set(clusters)) >= LEAST_GROUPS
                    else "(too few groups)"
                ),
            }
        )
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
    differences: list[Row] = []
    all_chosen: list[Encounter] = []
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
        rows += line(chosen[0].recording, chosen, found)
        differences += paired(chosen[0].recording, chosen, found)
        all_chosen += chosen
        everything += found
    if everything:
        rows += line("all", all_chosen, everything)
        differences += paired("all", all_chosen, everything)
    note = (
        "Each pair is observed (at most 9 times, every 0.4 s) until 2 s before its first agent "
        "crosses, or until both have been seen 4 times, and the next 4 s are predicted; pairs seen "
        "together less than 0.4 s before the crossing are left out. Lead and history: medians of "
        "the time left to the crossing and of the observations. Errors: means with 95 % "
        "intervals. Won: share of pairs with the smaller ADE. "
        + ("Closest pairs only. " if setting.quick else "All crossing pairs. ")
        + (f"Without a usable pair: {', '.join(without)}." if without else "")
    )
    told = (
        "Mean differences of the pairs above (negative: foresight is better), with 95 % bootstrap "
        "intervals that resample whole groups of pairs that share agents."
    )
    return [
        Result(TITLE, note, rows).show(setting.console),
        Result(f"{TITLE}: paired differences", told, differences).show(setting.console),
    ]
