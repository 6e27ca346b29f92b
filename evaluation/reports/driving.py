"""Tables and figures of the driving study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.figures import save
from evaluation.reports.naming import OTHERS, colour_of, heading_of, label_of
from evaluation.reports.tables import mean_and_half
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, TIME_OUT
from evaluation.studies.driving import (
    DrivingSummary,
    good_rows,
    paired,
    summarise,
)
from foresight_env.scenarios.driving import DT

PAPER_DISTANCE = 6.0
"""The paper's ego never came nearer to another car's middle, m."""


def place(scene: str, others: str) -> str:
    """Title of a table or a panel."""
    return f"{scene.replace('_', ' ')}, {OTHERS[others]}"


def print_driving(
    console: Console,
    rows: Sequence[Row],
    scenes: Sequence[str],
    others: Sequence[str],
    egos: Sequence[str],
) -> None:
    """One table per scene and kind of others, then paired differences of infer-gamma."""
    for scene in scenes:
        for other in others:
            found = [summarise(rows, scene, other, ego) for ego in egos]
            finished = [s for s in found if s is not None]
            console.print(_table(place(scene, other), finished, console.width))
            if "infer-gamma" in egos:
                _print_paired(console, rows, scene, other, egos)
    console.print(
        "time to goal: the time limit where it was not reached. at fault: the ego moved, and the "
        "car that it hit was ahead of its middle. Accelerations and jerk: root mean squares."
    )
    if errors := errors_of(rows):
        console.print(f"[red]{escape(failed(errors))}[/red]")


def _table(title: str, summaries: Sequence[DrivingSummary], width: int) -> Table:
    table = Table(title=title)
    table.add_column("", no_wrap=True)
    for s in summaries:
        table.add_column(escape(heading_of(s.ego, width)), justify="right")
    ends = {
        COLLISION: [f"{s.ends[COLLISION]} ({s.faults} at fault)" for s in summaries],
        **{e: [str(s.ends[e]) for s in summaries] for e in (OFF_ROAD, REACHED, TIME_OUT)},
    }
    lines: dict[str, list[str]] = {
        "episodes": [str(s.episodes) for s in summaries],
        **ends,
        "gap of boxes [m]": [mean_and_half(s.gap) for s in summaries],
        "smallest of all [m]": [f"{s.least_gap:.2f}" for s in summaries],
        "distance of middles [m]": [mean_and_half(s.distance, 1) for s in summaries],
        "least of all [m]": [f"{s.least_distance:.1f}" for s in summaries],
        "time to goal [s]": [mean_and_half(s.time) for s in summaries],
        "acceleration [m/s^2]": [f"{s.rides['rms_acceleration']:.1f}" for s in summaries],
        "jerk [m/s^3]": [f"{s.rides['rms_jerk']:.0f}" for s in summaries],
        "lateral [m/s^2]": [f"{s.rides['rms_lateral']:.1f}" for s in summaries],
        "decision p50, p99 [ms]": [
            f"{s.latencies[0]:.0f}, {s.latencies[1]:.0f}" for s in summaries
        ],
        "filter interventions": [str(s.interventions) for s in summaries],
        "failed plans, fits": [f"{s.failed_plans}, {s.failed_fits}" for s in summaries],
        "others' failed solves": [str(s.oracle_failures) for s in summaries],
    }
    if any(s.failed for s in summaries):
        lines["failed trials"] = [str(s.failed) for s in summaries]
    for name, cells in lines.items():
        table.add_row(escape(name), *cells)
    return table


def _print_paired(
    console: Console, rows: Sequence[Row], scene: str, others: str, egos: Sequence[str]
) -> None:
    console.print("infer-gamma minus the others, same seeds:")
    for other in egos:
        found = paired(rows, scene, others, "infer-gamma", other)
        if other != "infer-gamma" and found is not None:
            console.print(
                f"  {escape(label_of(other))}: collisions {found.collisions:+d}, gap "
                f"{mean_and_half(found.gap)} m, time to goal {mean_and_half(found.time)} s "
                f"({found.seeds} seeds)"
            )


def distances_over_time(
    rows: Sequence[Row], scene: str, others: str, egos: Sequence[str], path: Path
) -> Path:
    """The paper's figure: distance to the nearest car and to the goal, mean and 10-90 % band."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, column in zip(panels, ("distances", "goal_distances"), strict=True):
        for k, ego in enumerate(egos):
            mine = good_rows(rows, scene, others, ego)
            if mine:
                # Thinner and thinner: where egos do the same, each line still shows.
                width = max(1.0, 5.0 - k)
                _band(axes, [np.asarray(r[column]) for r in mine], ego, width)
        axes.set_xlabel("time [s]")
        axes.set_ylim(bottom=0.0)
    panels[0].axhline(PAPER_DISTANCE, color="black", ls=":", lw=1.0, label="6 m (paper's least)")
    panels[0].set_ylabel("middle to the nearest middle [m]")
    panels[1].set_ylabel("distance to the goal [m]")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=6)
    figure.suptitle(
        f"{place(scene, others)}: mean and 10-90 % band; episodes that ended keep their last value",
        fontsize=9,
    )
    return save(figure, path)


def _band(axes: Axes, series: Sequence[Float[np.ndarray, "_"]], ego: str, width: float) -> None:
    """Lines of different lengths, each held at its end."""
    longest = max(map(len, series))
    held = np.stack([np.pad(s, (0, longest - len(s)), mode="edge") for s in series])
    times = DT * np.arange(longest)
    axes.plot(times, held.mean(axis=0), color=colour_of(ego), lw=width, label=label_of(ego))
    low, high = np.percentile(held, [10, 90], axis=0)
    axes.fill_between(times, low, high, color=colour_of(ego), alpha=0.15, lw=0)
