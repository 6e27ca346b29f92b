"""`foresight estimate --whole` and `--observe`: discount factors of recorded encounters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.reports.figures import save
from evaluation.reports.naming import file_name
from evaluation.reports.partial_encounter import (
    partial_encounter_picture,
    print_partial_encounters,
)
from evaluation.reports.terminal import terminal
from evaluation.windows.partial_encounter import predict_encounters
from evaluation.windows.whole_encounter import WholeEncounter, fit_whole_encounters
from foresight_env.datasets import Recording

COLOURS = ("#0072B2", "#D55E00")


def estimate_whole(
    recording: Recording,
    agents: tuple[str, ...] | None,
    count: int | None,
    collision_weight: float,
    pictures: bool,
    out: Path,
) -> None:
    """`foresight estimate --whole`: a table, and a picture of each encounter."""
    console = terminal()
    if pictures:
        out.mkdir(parents=True, exist_ok=True)  # an unwritable folder is reported before the work
    with console.status("inferring (the first fit compiles)"):
        fits = fit_whole_encounters(
            recording, agents=agents, count=count, collision_weight=collision_weight
        )
    print_whole_encounters(console, fits, collision_weight)
    for fit in fits if pictures else ():
        name = file_name(fit.recording, fit.agents, "whole")
        path = whole_encounter_picture(fit, out / f"{name}.png")
        console.print(f"picture: {path}", soft_wrap=True, markup=False)


def estimate_part(
    recording: Recording,
    agents: tuple[str, ...] | None,
    count: int | None,
    collision_weight: float,
    observed_seconds: float,
    pictures: bool,
    out: Path,
) -> None:
    """`foresight estimate --observe`: a table, and a picture of each encounter.

    Args:
        recording: with the agents.
        agents: two ids; None for the closest crossings.
        count: how many of these; None for all.
        collision_weight: of the encounter game, known.
        observed_seconds: from the start of the encounter (`encounter_window`).
        pictures: whether to draw.
        out: folder of the pictures.
    """
    console = terminal()
    if pictures:
        out.mkdir(parents=True, exist_ok=True)  # an unwritable folder is reported before the work
    with console.status("inferring (the first fit compiles)"):
        found = predict_encounters(
            recording,
            observed_seconds,
            agents=agents,
            count=count,
            collision_weight=collision_weight,
        )
    print_partial_encounters(console, found)
    for encounter in found if pictures else ():
        name = file_name(encounter.recording, encounter.agents, "part")
        path = partial_encounter_picture(encounter, out / f"{name}.png")
        console.print(f"picture: {path}", soft_wrap=True, markup=False)


def look_ahead(gamma: float, dt: float) -> float:
    """Time (s) after which a cost has 1 / e of its weight; infinite for gamma = 1."""
    if gamma <= 0.0:
        return 0.0
    return math.inf if gamma >= 1.0 else -dt / math.log(gamma)


def print_whole_encounters(
    console: Console, fits: Sequence[WholeEncounter], collision_weight: float
) -> None:
    """Print the inferred discount factors with their intervals."""
    dt = fits[0].dt
    title = f"{fits[0].recording}: whole encounters, gamma per {dt:.2g} s"
    table = Table(title=escape(title))
    for heading in ("agent", "gamma", "90 % interval", "looks ahead [s]", "residual [m]"):
        table.add_column(escape(heading), justify="left" if heading == "agent" else "right")
    for fit in fits:
        for i, agent in enumerate(fit.agents):
            gamma = float(fit.estimate.gamma[i])
            low, high = fit.estimate.gamma_interval[i]
            known = bool(fit.estimate.gamma_identifiable[i])
            table.add_row(
                escape(agent),
                f"{gamma:.2f}",
                f"{low:.2f} to {high:.2f}" + ("" if known else " (not identifiable)"),
                f"{look_ahead(gamma, dt):.1f}",
                f"{fit.noise_std:.3f}",
                end_section=i == 1,
            )
    console.print(table)
    console.print(
        f"Given the encounter game with --collision-weight {collision_weight:g}. looks ahead: time "
        "after which a cost has 1/e of its weight. residual: standard deviation of the positions "
        "about the fit, also taken for their noise; a weight that fits better leaves less.",
        highlight=False,
    )


def whole_encounter_picture(fit: WholeEncounter, path: Path) -> Path:
    """Draw the observed and the fitted paths, and the intervals of both discount factors."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    scene, bars = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    fitted, estimate = fit.fitted, fit.estimate
    for i, (agent, colour) in enumerate(zip(fit.agents, COLOURS, strict=True)):
        scene.plot(*fit.observed[:, i].T, ".", color=colour, ms=5)
        scene.plot(*fitted[:, i].T, "-", color=colour, lw=1.5, label=agent)
        seen = np.flatnonzero(~np.isnan(fit.observed[:, i, 0]))
        start: Any = fit.observed[seen[0], i]
        scene.plot(*start, "o", color=colour, ms=9, mfc="white")
        low, high = estimate.gamma_interval[i]
        known = bool(estimate.gamma_identifiable[i])
        bars.plot([i, i], [low, high], color=colour, lw=5, alpha=0.4, solid_capstyle="butt")
        bars.plot(i, estimate.gamma[i], "o", color=colour, mfc=colour if known else "white")
    scene.set_aspect("equal", "datalim")
    scene.margins(0.1)
    scene.set_xlabel("x [m]")
    scene.set_ylabel("y [m]")
    scene.legend(frameon=False)
    scene.set_title("observed (dots, circle: start) and fitted", fontsize=10)
    bars.set_xlim(-0.6, 1.6)
    bars.set_ylim(-0.02, 1.02)
    bars.set_xticks([0, 1], fit.agents)
    bars.set_ylabel(f"discount factor per {fit.dt:.2g} s")
    bars.set_title("estimate, 90 % interval", fontsize=10)
    return save(figure, path)
