"""Picture and columns of calibration: nominal and observed coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from evaluation.metrics.calibration import BINS, NOMINAL, coverage
from evaluation.reports.figures import save
from evaluation.reports.naming import colour_of, label_of

Counts = Sequence[Sequence[int]]
"""Of `level_counts`, one per window."""
Curve = Float[np.ndarray, "_"]
"""Observed coverage at the nominal probabilities 1 / `BINS`, ..., 1."""

EXPLANATION = (
    "Coverage: share of true positions in the regions to which a forecast gives 50 % and 90 % "
    "probability, the smallest such regions of its mixture, each step and agent by itself; 50 % "
    "and 90 % are right."
)


def curve_of(counts: Sequence[Sequence[int] | None]) -> Curve | None:
    """Return the coverage over windows; None where a forecast has no covariances."""
    known = [window for window in counts if window is not None]
    return coverage(known) if known else None


def coverage_cells(curve: Curve | None) -> dict[str, str]:
    """Return cells of a table by column: coverage of the regions of `NOMINAL` probability."""
    return {
        f"{nominal:.0%} region": "-" if curve is None else f"{curve[round(nominal * BINS) - 1]:.0%}"
        for nominal in NOMINAL
    }


def reliability(panels: Mapping[str, Mapping[str, Curve]], path: Path) -> Path:
    """Draw observed over nominal coverage: a panel per title, a line per predictor."""
    names = list(dict.fromkeys(name for curves in panels.values() for name in curves))
    width = 3.6 * len(panels) + 0.4
    columns = max(2, int(width / 2.1))
    legend_rows = -(-(len(names) + 1) // columns)
    figure = Figure(figsize=(width, 3.6 + 0.2 * legend_rows), layout="constrained")
    axes_of = figure.subplots(1, len(panels), squeeze=False)[0]
    nominal = np.arange(BINS + 1) / BINS
    lines = {}
    for axes, (title, curves) in zip(axes_of, panels.items(), strict=True):
        (even,) = axes.plot(nominal, nominal, color="#999999", lw=1.0, ls="--")
        for name, curve in curves.items():
            (lines[name],) = axes.plot(
                nominal, np.concatenate([[0.0], curve]), color=colour_of(name), lw=1.5
            )
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("nominal probability")
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(0.0, 1.0)
        axes.set_aspect("equal")
    axes_of[0].set_ylabel("observed coverage")
    figure.legend(
        [*lines.values(), even],
        [*(label_of(name) for name in lines), "calibrated"],
        loc="outside lower center",
        ncols=columns,
        fontsize=8,
    )
    return save(figure, path)
