"""Table and picture of encounters that were observed in part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.reports.figures import save
from evaluation.reports.naming import colour_of, label_of
from evaluation.windows.partial_encounter import PartialEncounter

FIRST_DRAWN = "constant-velocity", "assume-gamma-1", "infer-gamma"
"""The last lies on top."""


def print_partial_encounters(
    console: Console,
    encounters: Sequence[PartialEncounter],
    true_gammas: Mapping[str, float] | None = None,
) -> None:
    """Print inferred discount factors with intervals, and prediction errors.

    Args:
        console: to print on.
        encounters: at least one.
        true_gammas: by agent, where they are known.
    """
    first = encounters[0]
    seen = (first.num_observed - 1) * first.dt
    table = Table(
        title=escape(
            f"{first.recording}: first {seen:.1f} s observed, {_predicted_seconds(first):.1f} s "
            f"predicted; gamma per {first.dt:.2g} s"
        )
    )
    table.add_column("agents")
    table.add_column(escape("gamma [90 %]" + (", true" if true_gammas else "")), justify="right")
    for name in first.predicted:
        table.add_column(escape(f"ADE [m]: {label_of(name)}"), justify="right")
    for encounter in encounters:
        best = min(encounter.average_errors.values())
        table.add_row(
            escape("\n".join(encounter.agents)),
            escape(
                "\n".join(
                    _told(encounter, i, (true_gammas or {}).get(agent))
                    for i, agent in enumerate(encounter.agents)
                )
            ),
            *(
                f"[bold]{error:.2f}[/bold]" if error == best else f"{error:.2f}"
                for error in encounter.average_errors.values()
            ),
            end_section=True,
        )
    console.print(table)


def _predicted_seconds(encounter: PartialEncounter) -> float:
    return (len(encounter.positions) - encounter.num_observed) * encounter.dt


def _told(encounter: PartialEncounter, i: int, true: float | None) -> str:
    low, high = encounter.estimate.gamma_interval[i]
    told = f"{encounter.estimate.gamma[i]:.2f} [{low:.2f}, {high:.2f}]"
    if not encounter.estimate.gamma_identifiable[i]:
        told += " open"
    return told if true is None else f"{told}, {true:g}"


def partial_encounter_picture(encounter: PartialEncounter, path: Path) -> Path:
    """Draw observed positions, those that followed and the predictions, with errors over time.

    Args:
        encounter: with its predictions.
        path: of the picture, .png or .pdf.

    Returns:
        The path.
    """
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    scene, errors = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    count, positions = encounter.num_observed, encounter.positions
    for i, agent in enumerate(encounter.agents):
        seen = positions[:count, i]
        scene.plot(*seen.T, ".", color="0.45", label="observed" if i == 0 else None)
        later: Any = positions[count - 1 :, i]
        truth = "recorded later" if i == 0 else None
        scene.plot(*later.T, "-", color="black", lw=5, alpha=0.25, label=truth)
        start: Any = seen[~np.isnan(seen[:, 0])][0]
        scene.annotate(agent, start, (6, -12), textcoords="offset points", fontsize=9)
    for name in FIRST_DRAWN:
        found = encounter.predicted[name]
        for i in range(len(encounter.agents)):
            line: Any = np.concatenate([positions[count - 1 : count, i], found[:, i]])
            scene.plot(
                *line.T, ".-", ms=3, lw=1.3, color=colour_of(name),
                label=label_of(name) if i == 0 else None,
            )  # fmt: skip
        distance = np.linalg.norm(found - positions[count:], axis=-1)
        seconds = encounter.dt * np.arange(1, len(found) + 1)
        there = ~np.isnan(distance).all(axis=1)
        errors.plot(seconds[there], np.nanmean(distance[there], axis=1), color=colour_of(name))
    scene.set_aspect("equal", "datalim")
    scene.margins(0.08)
    scene.set_xlabel("x [m]")
    scene.set_ylabel("y [m]")
    scene.legend(fontsize=8, frameon=False)
    scene.set_title(f"{encounter.recording}: {' and '.join(encounter.agents)}", fontsize=10)
    errors.set_xlim(0.0)
    errors.set_ylim(0.0)
    errors.set_xlabel("seconds after the last observation")
    errors.set_ylabel("mean distance to the recorded positions [m]")
    errors.grid(alpha=0.3)
    return save(figure, path)
