"""Result tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.closed_loop import Summary, paired_difference
from evaluation.estimation import LEAST_STD, METHODS, bound
from evaluation.recorded import Encounter, Forecast
from evaluation.statistics import Interval, mean_interval
from evaluation.store import Row


def _pm(interval: Interval, digits: int = 2) -> str:
    return f"{interval.mean:.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def print_closed_loop(console: Console, summaries: Sequence[Summary], rows: Sequence[Row]) -> None:
    """One line per ego, then paired differences of foresight against the others."""
    table = Table(title="Closed loop: the ego walks among short-sighted others (means with 95 %)")
    for name in (
        "ego", "episodes", "collisions", "goal reached", "min distance [m]", "smallest [m]",
        "time to goal [s]", "cost", "decision p50 / p99 [ms]", "failed solves",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "ego" else "right")
    for s in summaries:
        count = f"{s.episodes}" + (f" ({s.errors} broke)" if s.errors else "")
        table.add_row(
            s.ego, count, str(s.collisions), str(s.reached), _pm(s.min_distance),
            f"{s.smallest_distance:.2f}", _pm(s.time_to_goal), _pm(s.cost, 1),
            f"{s.latency_median:.0f} / {s.latency_p99:.0f}", str(s.failures),
        )  # fmt: skip
    console.print(table)
    names = [s.ego for s in summaries]
    if "foresight" not in names:
        return
    for other in names:
        if other != "foresight":
            cost = paired_difference(list(rows), "foresight", other, "cost")
            distance = paired_difference(list(rows), "foresight", other, "min_distance")
            console.print(
                f"foresight minus {other}, same seeds: cost {_pm(cost, 1)}, "
                f"min distance {_pm(distance)} m"
            )


def print_estimation(console: Console, rows: Sequence[Row]) -> None:
    """Mean error per noise level beside the Cramer-Rao bound."""
    table = Table(
        title="Estimation from one noisy crossing: mean trajectory error ||X - X_true||^2"
    )
    for name in (
        "observed", "noise std", "sequences", "gamma inferred", "gamma = 1", "Cramer-Rao",
        "inferred / bound", "seconds",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "observed" else "right")
    keys = sorted({(r["observation"], r["std"]) for r in rows})
    for observation, std in keys:
        mean: dict[str, float] = {}
        count, seconds = 0, []
        for method in METHODS:
            mine = [
                r for r in rows
                if (r["observation"], r["std"], r["method"]) == (observation, std, method)
                and not r["error"]
            ]  # fmt: skip
            mean[method] = float(np.mean([r["error_squared"] for r in mine])) if mine else np.nan
            count = max(count, len(mine))
            seconds += [r["seconds"] for r in mine if method == "foresight"]
        limit = bound(observation) * std**2
        table.add_row(
            observation, f"{std:.3f}", str(count), f"{mean['foresight']:.3g}",
            f"{mean['farsighted']:.3g}", f"{limit:.3g}" if std > LEAST_STD else "0",
            f"{mean['foresight'] / limit:.2f}" if std > LEAST_STD else "",
            f"{np.median(seconds):.2f}" if seconds else "",
        )  # fmt: skip
    console.print(table)
    broken = sum(bool(r["error"]) for r in rows)
    if broken:
        console.print(f"[red]{broken} trials broke; their rows in the results say why[/red]")


def print_encounters(
    console: Console, results: Sequence[tuple[Encounter, Sequence[Forecast]]]
) -> None:
    """Errors per encounter and method, and the means."""
    table = Table(title="Recorded encounters: prediction errors, ADE / FDE [m]")
    table.add_column("recording")
    table.add_column("agents")
    names = [f.method for f in results[0][1]]
    for name in names:
        table.add_column(name, justify="right")
    table.add_column("inferred gammas", justify="right")
    for encounter, forecasts in results:
        cells = [
            f"{f.average_error:.2f} / {f.final_error:.2f}" + ("" if f.solved else " (fallback)")
            for f in forecasts
        ]
        table.add_row(
            encounter.recording, ", ".join(encounter.interaction.agents), *cells, _gammas(forecasts)
        )
    console.print(table)
    if len(results) > 1:
        for k, name in enumerate(names):
            average = mean_interval(np.array([f[k].average_error for _, f in results]))
            final = mean_interval(np.array([f[k].final_error for _, f in results]))
            console.print(f"{name}: mean ADE {_pm(average)} m, mean FDE {_pm(final)} m")


def _gammas(forecasts: Sequence[Forecast]) -> str:
    for found in forecasts:
        if found.method == "foresight" and found.gamma is not None:
            deviation = found.gamma_deviation
            if deviation is not None:
                pairs = zip(found.gamma, deviation, strict=True)
                return ", ".join(f"{g:.2f} +- {1.645 * d:.2f}" for g, d in pairs)
    return "-"
