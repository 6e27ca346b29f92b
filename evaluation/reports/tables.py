"""Result tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.metrics.statistics import Interval, mean_interval
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.naming import heading_of, label_of
from evaluation.rollout.setting import MAX_STEPS
from evaluation.studies.closed_loop import ClosedLoopSummary, paired_difference
from evaluation.studies.estimation import LEAST_STD, METHODS, bound
from evaluation.windows.encounters import Encounter, Judged
from foresight_env.envs.rendering.style import INTERVAL_DEVIATIONS
from foresight_env.scenarios.crosswalk import DT


def mean_and_half(interval: Interval | None, digits: int = 2) -> str:
    """Mean and the larger half of its interval: short enough for a narrow terminal."""
    if interval is None or not np.isfinite(interval.mean):
        return "-"
    half = max(interval.high - interval.mean, interval.mean - interval.low)
    # A single value has no interval: it must not look certain.
    return f"{interval.mean:.{digits}f}" + (f" ±{half:.{digits}f}" if half > 0.0 else "")


def print_closed_loop(
    console: Console, summaries: Sequence[ClosedLoopSummary], rows: Sequence[Row]
) -> None:
    """One column per ego, then paired differences of infer-gamma against the others."""
    table = Table(title="Closed loop: an ego among short-sighted others (means ±95 %)")
    table.add_column("", no_wrap=True)
    for s in summaries:
        table.add_column(escape(heading_of(s.ego, console.width)), justify="right")
    lines: dict[str, list[str]] = {
        "episodes": [str(s.episodes) for s in summaries],
        "collisions": [str(s.collisions) for s in summaries],
        "goal reached": [str(s.reached) for s in summaries],
        "timed out": [str(s.time_outs) for s in summaries],
        "min distance [m]": [mean_and_half(s.min_distance) for s in summaries],
        "smallest of all [m]": [f"{s.smallest_distance:.2f}" for s in summaries],
        "time to goal [s]": [mean_and_half(s.time_to_goal) for s in summaries],
        "cost, unharmed": [mean_and_half(s.cost, 1) for s in summaries],
        "decision p50 [ms]": [f"{s.latency_median:.0f}" for s in summaries],
        "decision p99 [ms]": [f"{s.latency_p99:.0f}" for s in summaries],
        "filter interventions": [str(s.interventions) for s in summaries],
        "failed plans": [str(s.failed_plans) for s in summaries],
        "failed fits": [str(s.failed_fits) for s in summaries],
    }
    if any(s.failed for s in summaries):
        lines["failed trials"] = [str(s.failed) for s in summaries]
    for name, cells in lines.items():
        table.add_row(escape(name), *cells)
    console.print(table)
    console.print(f"time to goal: episodes that did not reach it count with {MAX_STEPS * DT:g} s.")
    if errors := errors_of(rows):
        console.print(f"[red]{escape(failed(errors))}[/red]")
    names = [s.ego for s in summaries]
    if "oracle" in names:
        console.print(
            "The oracle plays the others' own equilibrium; a best response to them may do better "
            "(foresight value)."
        )
    if "infer-gamma" not in names:
        return
    console.print(
        "infer-gamma minus the others, same seeds (cost: those where neither collided, negative "
        "is better):"
    )
    for other in names:
        if other != "infer-gamma":
            cost = paired_difference(
                list(rows), "infer-gamma", other, "cost", with_collisions=False
            )
            distance = paired_difference(list(rows), "infer-gamma", other, "min_distance")
            console.print(
                f"  {escape(label_of(other))}: cost {mean_and_half(cost, 1)}, min distance "
                f"{mean_and_half(distance)} m"
            )


FAR_BELOW = 0.5
"""Ratio of an error to its bound that chance does not explain."""


def print_estimation(console: Console, rows: Sequence[Row]) -> None:
    """Mean error per noise level and the Cramer-Rao bound."""
    table = Table(title="Estimation: mean trajectory error, Cramer-Rao bound, ratio to it")
    for name in (
        "observed", "std", "n", *METHODS, "bound", "ratio", "time [s]",
    ):  # fmt: skip
        table.add_column(escape(name), justify="left" if name == "observed" else "right")
    far_below = False
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
            seconds += [r["seconds"] for r in mine if method == "infer-gamma"]
        limit = bound(observation) * std**2
        far_below |= std > LEAST_STD and mean["infer-gamma"] < FAR_BELOW * limit
        table.add_row(
            observation, f"{std:.3f}", str(count), f"{mean['infer-gamma']:.3g}",
            f"{mean['assume-gamma-1']:.3g}", f"{limit:.3g}" if std > LEAST_STD else "0",
            f"{mean['infer-gamma'] / limit:.2f}" if std > LEAST_STD else "",
            f"{np.median(seconds):.2f}" if seconds else "",
        )  # fmt: skip
    console.print(table)
    if far_below:
        console.print(
            "Errors far below the bound: it is local, and so knows nothing of the limits on "
            "velocities and discount factors, which restrict how wrong a trajectory can be."
        )
    if errors := errors_of(rows):
        console.print(f"[red]{escape(failed(errors))}[/red]")


def print_encounters(
    console: Console, results: Sequence[tuple[Encounter, Sequence[Judged]]]
) -> None:
    """Errors per encounter and method, and the means."""
    recordings = list(dict.fromkeys(encounter.window.recording for encounter, _ in results))
    several = len(recordings) > 1
    subject = "Recorded encounters" if several else recordings[0]
    table = Table(title=escape(f"{subject}: prediction errors, ADE / FDE [m]; gammas ±90 %"))
    if several:
        table.add_column("recording")
    table.add_column("agents")
    table.add_column("steps", justify="right")
    names = [f.predictor for f in results[0][1]]
    for name in names:
        table.add_column(escape(heading_of(name, console.width)), justify="right")
    table.add_column("gammas", justify="right")
    for encounter, forecasts in results:
        cells = [
            f"{f.average_error:.2f} / {f.final_error:.2f}"
            + (" (fallback)" if f.forecast.fallback else "")
            for f in forecasts
        ]
        table.add_row(
            *([escape(encounter.window.recording)] if several else []),
            escape("\n".join(encounter.window.agents)),
            "\n".join(str(steps) for steps in encounter.window.present.sum(axis=0)),
            *cells,
            _gammas(forecasts),
            end_section=True,
        )
    console.print(table)
    console.print(
        "steps: predicted positions with a recorded one to compare with. open: the observations do "
        "not identify this gamma. limit: it rests on an end of its range."
    )
    if len(results) > 1:
        for k, name in enumerate(names):
            average = mean_interval(np.array([f[k].average_error for _, f in results]))
            final = mean_interval(np.array([f[k].final_error for _, f in results]))
            console.print(
                f"{escape(label_of(name))}: mean ADE {mean_and_half(average)} m, mean FDE "
                f"{mean_and_half(final)} m"
            )


def told_gamma(mean: float, deviation: float, identifiable: bool = True) -> str:
    """An inferred discount factor with half of its 90 % interval, or why it has none."""
    if not identifiable:
        return f"{mean:.2f} (open)"
    if deviation == 0.0:
        return f"{mean:.2f} (limit)"
    return f"{mean:.2f} ±{INTERVAL_DEVIATIONS * deviation:.2f}"


def _gammas(forecasts: Sequence[Judged]) -> str:
    for judged in forecasts:
        found = judged.forecast
        parts: Any = found.gamma, found.gamma_deviation, found.gamma_identifiable
        if judged.predictor == "encounter-game" and found.gamma is not None:
            values = zip(*(part.tolist() for part in parts), strict=True)
            return "\n".join(told_gamma(*each) for each in values)
    return "-"
