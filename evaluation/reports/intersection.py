"""Tables and pictures of a recorded window at an intersection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import LogFormatter
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.metrics.statistics import mean_and_error
from evaluation.reports.digits import significant
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.figures import AGENTS, save
from evaluation.reports.naming import colour_of, label_of
from evaluation.studies.intersection import METHODS
from evaluation.studies.junction_comparison import Comparison
from evaluation.windows.intersection import Case
from foresight_env.scenarios.intersection import Violation
from foresight_env.scenarios.junction import JUNCTION_REGION

LABELLED_DECADES = (4.0, 0.5)
"""Length of an axis up to which some, and all, ticks between powers of ten have a number."""
SNAPSHOT = "snapshot"
"""Name of the picture of a prediction, next to the study's folder."""
VIEW_MARGIN = 4.0
"""Free space around all agents in the snapshot, m."""


def _values(
    rows: Sequence[Row], column: str, observation: str, std: float, method: str
) -> np.ndarray:
    wanted = observation, std, method
    return np.array(
        [
            r[column]
            for r in rows
            if (r["observation"], r["std"], r["method"]) == wanted and not r["error"]
        ]
    )


def print_errors(console: Console, rows: Sequence[Row]) -> None:
    """Mean trajectory error of each method over noise, with bootstrap standard errors."""
    table = Table(title="Errors against the recording")
    for name in ("observed", "std", "method", "n", "||X - X_recorded||^2", "ratio", "ADE [m]"):
        table.add_column(
            escape(name), justify="left" if name in ("observed", "method") else "right"
        )
    settings = sorted({(r["observation"], r["std"]) for r in rows})
    for observation, std in settings:
        base = _values(rows, "error_squared", observation, std, "assume-gamma-1")
        for method in METHODS:
            errors = _values(rows, "error_squared", observation, std, method)
            if errors.size == 0:
                continue
            mean, spread = mean_and_error(errors)
            ratio = f"{mean / base.mean():.2f}" if base.size else ""
            distance = _values(rows, "average_displacement", observation, std, method).mean()
            table.add_row(
                observation,
                f"{std:.3f}",
                label_of(method),
                str(errors.size),
                significant(mean, 3) + (f" ±{significant(spread, 2)}" if spread > 0.0 else ""),
                ratio,
                f"{distance:.2f}",
                end_section=method == METHODS[-1],
            )
    console.print(table)
    console.print("±: bootstrap standard error. ratio: to assume-gamma-1. ADE: mean distance.")
    unsolved = sum(not r["error"] and not r["solved"] for r in rows)
    if unsolved:
        console.print(f"[red]{unsolved} fits not solved[/red]")
    if failures := errors_of(rows):
        console.print(f"[red]{escape(failed(failures))}[/red]")


def print_gammas(console: Console, rows: Sequence[Row]) -> None:
    """Inferred discount factors at the least noise, by class of agent."""
    table = Table(title="Inferred discount factors, least noise: 90 % intervals")
    for name in ("class", "agent", "observed", "gamma", "interval"):
        table.add_column(name)
    mine = [r for r in rows if r["method"] == "infer-gamma" and not r["error"] and r["gamma"]]
    least = min((r["std"] for r in mine), default=0.0)
    chosen = [r for r in mine if r["std"] == least and r["sequence"] == 0]
    kinds = chosen[0]["kinds"] if chosen else []
    for kind in dict.fromkeys(kinds):
        values = []
        for i in (i for i, k in enumerate(kinds) if k == kind):
            for row in chosen:
                low, high = row["gamma_low"][i], row["gamma_high"][i]
                text = f"{low:.2f} to {high:.2f}" if row["gamma_identifiable"][i] else "open"
                table.add_row(
                    kind, row["agents"][i], row["observation"], f"{row['gamma'][i]:.2f}", text
                )
                values.append(row["gamma"][i])
        if values:
            table.add_row(kind, "mean", "", f"{np.mean(values):.2f}", "", end_section=True)
    console.print(table)
    console.print("open: not identifiable from the observations.")


def print_violations(console: Console, found: Mapping[str, Sequence[Violation]]) -> None:
    """Print which parts of the region do not bind an agent, and why."""
    for agent, violations in found.items():
        for violation in violations:
            console.print(
                f"{agent}: recorded {violation.depth:.1f} m inside {violation.part} "
                f"{violation.number + 1} of the region, which in the fit to all steps binds none "
                "of its class",
                markup=False,
            )


def print_comparison(
    console: Console, case: Case, known: int, comparisons: Sequence[Comparison]
) -> None:
    """Print how well both games explain a window, and how well they predict its rest."""
    seconds = case.dt * (len(case.states) - known)
    steps = len(case.states)
    table = Table(
        title=f"Fit to all {steps} steps; prediction of the last {seconds:.1f} s from {known} steps"
    )
    for name in ("game", "method", "fit: ||X - X_recorded||^2", "ADE [m]"):
        table.add_column(escape(name), justify="left" if name in ("game", "method") else "right")
    for name in ("prediction: ADE [m]", "FDE [m]"):
        table.add_column(escape(name), justify="right")
    for c in comparisons:
        table.add_row(
            c.game or "-",
            label_of(c.method),
            significant(c.fit_squared, 3) + ("" if c.fit_solved else " (failed)"),
            f"{c.fit_displacement:.2f}",
            f"{c.average_error:.2f}" + ("" if c.prediction_solved else " (failed)"),
            f"{c.final_error:.2f}",
            end_section=c.method != "infer-gamma",
        )
    console.print(table)
    console.print("Where a fit failed, constant velocity counts instead.")


def print_compared_gammas(console: Console, case: Case, comparisons: Sequence[Comparison]) -> None:
    """Print the discount factors that each game infers from the whole window."""
    table = Table(title="Discount factors inferred from the whole window: 90 % intervals")
    for name in ("game", "class", "agent", "gamma", "interval"):
        table.add_column(name)
    for c in comparisons:
        if c.gamma is None or c.gamma_interval is None or c.gamma_identifiable is None:
            continue
        for i, (agent, kind) in enumerate(zip(case.agents, case.kinds, strict=True)):
            low, high = c.gamma_interval[i]
            known = bool(c.gamma_identifiable[i])
            table.add_row(
                c.game,
                kind,
                agent,
                f"{c.gamma[i]:.2f}",
                f"{low:.2f} to {high:.2f}" + ("" if known else " (not identifiable)"),
                end_section=i == len(case.agents) - 1,
            )
    console.print(table)
    console.print("Published: gamma per step. Realistic: gamma per second.")
    for c in comparisons:
        if c.gamma is not None:
            text = ", ".join(c.unidentified) or "none"
            console.print(
                f"{c.game}: {c.free} free parameters; not identifiable from the window: {text}",
                markup=False,
            )


def error_over_noise(rows: Sequence[Row], path: Path) -> Path:
    """The paper's figure: mean error of every method over noise, standard errors as bars."""
    observations = sorted({r["observation"] for r in rows})
    figure = Figure(figsize=(4.6 * len(observations), 3.8), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(observations), sharey=True))
    for axes, observation in zip(panels, observations, strict=True):
        for method in METHODS:
            stds = sorted({r["std"] for r in rows})
            found = [_values(rows, "error_squared", observation, std, method) for std in stds]
            summaries = [
                mean_and_error(values) if values.size else (np.nan, 0.0) for values in found
            ]
            means, spreads = np.array(summaries).T
            axes.errorbar(
                stds, means, yerr=spreads, fmt=".-", capsize=3,
                color=colour_of(method), label=label_of(method),
            )  # fmt: skip
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(LogFormatter(minor_thresholds=LABELLED_DECADES))
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=LABELLED_DECADES))
        axes.set_xlabel("noise standard deviation [m, m/s, rad]")
        axes.set_title("full state" if observation == "full" else "positions only")
    panels[0].set_ylabel("trajectory error ||X - X_recorded||^2")
    panels[0].legend(fontsize=8)
    return save(figure, path)


def snapshot(case: Case, known: int, predictions: Sequence[Comparison], path: Path) -> Path:
    """The paper's figure: observations, predictions of each game and method, ground truth."""
    columns = 3
    rows = -(-len(predictions) // columns)
    figure = Figure(figsize=(11.0, 4.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(predictions) :]:
        axes.remove()
    shown = case.states[..., :2][case.present]
    for axes, p in zip(panels, predictions, strict=False):
        if case.at_aachen:
            for side in JUNCTION_REGION.sides:
                start, end = np.array(side.start), np.array(side.end)
                far = start + 5.0 * (end - start)
                axes.plot(*np.stack([start, far]).T, color="0.7", lw=1.2, zorder=0)
            for corner in JUNCTION_REGION.corners:
                disc = Circle(corner.center, corner.radius, fill=False, ec="0.7", lw=1.2, zorder=0)
                axes.add_patch(disc)
        for i in range(len(case.agents)):
            colour = AGENTS[i % len(AGENTS)]
            axes.plot(*case.states[:known, i, :2].T, ".", color=colour, ms=4)
            axes.plot(*case.states[known - 1 :, i, :2].T, color="black", lw=4, alpha=0.25)
            axes.plot(*p.states[known - 1 :, i, :2].T, color=colour, lw=1.6)
            seen = case.states[:known, i, :2]
            here = seen[~np.isnan(seen[:, 0])][-1]
            axes.annotate(
                case.agents[i],
                here,
                xytext=(6, 5) if i % 2 else (-6, -11),
                ha="left" if i % 2 else "right",
                textcoords="offset points",
                fontsize=8,
            )
        label = f"{p.game}, {label_of(p.method)}" if p.game else label_of(p.method)
        axes.set_title(f"{label}: ADE {p.average_error:.2f} m", fontsize=10)
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
    low, high = shown.min(axis=0) - VIEW_MARGIN, shown.max(axis=0) + VIEW_MARGIN
    panels[0].set_xlim(low[0], high[0])
    panels[0].set_ylim(low[1], high[1])
    panels[0].set_ylabel("y [m]")
    figure.suptitle(
        f"{case.name}, step {known}: observed (dots), predicted (coloured), ground truth (broad)",
        fontsize=9,
    )
    return save(figure, path)
