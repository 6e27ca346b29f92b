"""Tables and the picture of predictions on recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.metrics.prediction import SECONDS
from evaluation.metrics.ranks import LEAST_GROUPS
from evaluation.metrics.statistics import clustered_interval
from evaluation.reports.digits import significant
from evaluation.reports.failures import failed
from evaluation.reports.figures import save
from evaluation.reports.naming import colour_of, label_of
from evaluation.windows.table import WINDOW
from foresight_env.games.kinds import is_vehicle

FIRST = "encounter-game"
"""What the others are compared with, where it is among them."""

Part = tuple[str, str]
"""Data set and split."""
Line = dict[str, str | int]
"""Of a table: cells by column."""


def parts(rows: Sequence[Row]) -> list[Part]:
    """Which data sets and splits there are."""
    return sorted({(r["source"], r["split"]) for r in rows})


def _name(part: Part) -> str:
    return f"{part[0].upper()}, {part[1]}"


def predictors(rows: Sequence[Row]) -> list[str]:
    """Which predictors there are, the one that others are compared with first."""
    names = list(dict.fromkeys(r["predictor"] for r in rows))
    return sorted(names, key=lambda name: (name != FIRST, name != "encounter-game-gamma-1", name))


def _of(rows: Sequence[Row], part: Part, predictor: str) -> list[Row]:
    """One predictor's rows of windows that all predictors have finished, in the same order."""
    mine = [r for r in rows if (r["source"], r["split"]) == part]
    out = {tuple(r[k] for k in WINDOW) for r in mine if r["error"]}
    kept = [
        r for r in mine if r["predictor"] == predictor and tuple(r[k] for k in WINDOW) not in out
    ]
    return sorted(kept, key=lambda r: [r[k] for k in WINDOW])


def _column(rows: Sequence[Row], name: str) -> Float[np.ndarray, "n"]:
    return np.array([r[name] for r in rows], dtype=float)


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}"


def _mean(values: Float[np.ndarray, "n"]) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def summary(rows: Sequence[Row]) -> list[Line]:
    """A line per data set, split and predictor: means over windows."""
    lines: list[Line] = []
    for part in parts(rows):
        for predictor in predictors(rows):
            mine = _of(rows, part, predictor)
            if not mine:
                continue
            agents = sum(len(r["kinds"]) for r in mine)
            times = 1e3 * _column(mine, "seconds")
            lines.append(
                {
                    "data": _name(part),
                    "predictor": label_of(predictor),
                    "windows": len(mine),
                    "ADE [m]": f"{_mean(_column(mine, 'average_error')):.3f}",
                    "missed": f"{_column(mine, 'missed').sum() / agents:.0%}",
                    "predicted collisions (recorded)": (
                        f"{_column(mine, 'overlaps').sum():.0f} "
                        f"({_column(mine, 'overlaps_recorded').sum():.0f})"
                    ),
                    "fallback": int(_column(mine, "fallback").sum()),
                    "ms, p50 / p99": " / ".join(
                        significant(q, 2) for q in np.percentile(times, [50, 99])
                    ),
                }
            )
    return lines


def over_time(rows: Sequence[Row]) -> list[Line]:
    """A line per data set, split and predictor: ADE / FDE at the times at which they are told."""
    return [
        {
            "data": _name(part),
            "predictor": label_of(predictor),
            **{
                f"{t:g} s: ADE / FDE [m]": " / ".join(
                    f"{_mean(_column(mine, f'{kind}_{t:g}')):.2f}" for kind in ("ade", "fde")
                )
                for t in SECONDS
            },
        }
        for part in parts(rows)
        for predictor in predictors(rows)
        if (mine := _of(rows, part, predictor))
    ]


def likelihoods(rows: Sequence[Row]) -> list[Line]:
    """A line per data set, split and predictor: what forecasts of chances and many futures reach.

    Nothing where no predictor says more than one future.
    """
    if not any(
        r["best_average_error"] != r["average_error"] or r["nll"] is not None
        for r in rows
        if not r["error"]
    ):
        return []
    return [
        {
            "data": _name(part),
            "predictor": label_of(predictor),
            "best of 5: ADE / FDE [m]": " / ".join(
                f"{_mean(_column(mine, f'best_{kind}_error')):.2f}" for kind in ("average", "final")
            ),
            "NLL": _number(_mean(_column(mine, "nll"))),
        }
        for part in parts(rows)
        for predictor in predictors(rows)
        if (mine := _of(rows, part, predictor))
    ]


def differences(rows: Sequence[Row]) -> list[Line]:
    """ADE of the first predictor minus each other's, on the same windows."""
    lines: list[Line] = []
    for part in parts(rows):
        names = predictors(rows)
        first = _of(rows, part, names[0])
        for other in names[1:]:
            second = _of(rows, part, other)
            if not first or len(first) != len(second):
                continue
            gap = _column(first, "average_error") - _column(second, "average_error")
            groups = [r["group"] for r in first]
            interval = clustered_interval(gap, groups)
            enough = len(set(groups)) >= LEAST_GROUPS
            lines.append(
                {
                    "data": _name(part),
                    f"{label_of(names[0])} minus": label_of(other),
                    "windows": len(gap),
                    "groups": len(set(groups)),
                    "ADE [m]": f"{interval.mean:+.3f}"
                    + (
                        f" [{interval.low:+.3f}, {interval.high:+.3f}]"
                        if enough
                        else " (too few groups)"
                    ),
                    "won": f"{np.mean(gap < 0.0):.0%}",
                }
            )
    return lines


def by_class(rows: Sequence[Row]) -> list[Line]:
    """Mean ADE of people and of vehicles."""
    lines: list[Line] = []
    for part in parts(rows):
        for predictor in predictors(rows):
            mine = _of(rows, part, predictor)
            errors = {
                name: np.array(
                    [
                        e
                        for r in mine
                        for e, kind in zip(r["agent_errors"], r["kinds"], strict=True)
                        if chosen(kind)
                    ]
                )
                for name, chosen in CLASSES.items()
            }
            if mine:
                lines.append(
                    {
                        "data": _name(part),
                        "predictor": label_of(predictor),
                        **{
                            f"{name}: ADE [m]": f"{_mean(e):.3f} (n = {len(e)})" if len(e) else "-"
                            for name, e in errors.items()
                        },
                    }
                )
    return lines


CLASSES: dict[str, Callable[[str], bool]] = {
    "people": lambda kind: not is_vehicle(kind),
    "vehicles": is_vehicle,
}


def print_prediction(console: Console, rows: Sequence[Row]) -> None:
    """Print the tables and the first error."""
    for title, lines in (
        ("predictions, means over windows", summary(rows)),
        ("errors over time", over_time(rows)),
        ("several futures, and how likely they are", likelihoods(rows)),
        ("on the same windows", differences(rows)),
        ("by class of agent", by_class(rows)),
    ):
        for part in dict.fromkeys(line["data"] for line in lines):
            mine = [{k: v for k, v in e.items() if k != "data"} for e in lines if e["data"] == part]
            table = Table(title=f"{part}: {title}")
            for k, name in enumerate(mine[0]):
                table.add_column(escape(name), justify="right" if k else "left")
            for line in mine:
                table.add_row(*(escape(str(value)) for value in line.values()))
            console.print(table)
    console.print(
        "missed: agents predicted more than 2 m off at the last step they are there. predicted "
        "collisions: pairs whose footprints overlap (recorded: in the recording). fallback: "
        "windows predicted by constant velocity instead. Best of 5: of the five most likely joint "
        "futures the one of least ADE. NLL: negative log-likelihood (density in 1/m^2) of the "
        "ground truth, where a forecast has one; less is better. Brackets: 95 % intervals, whole "
        "groups of windows that share agents resampled."
    )
    errors = [f"{label_of(r['predictor'])}: {r['error']}" for r in rows if r["error"]]
    if errors:
        console.print(f"[red]{escape(failed(errors, 'prediction'))}[/red]")
        console.print("Windows of failed predictions are left out for all predictors.")


def error_over_time(rows: Sequence[Row], path: Path) -> Path:
    """Mean final displacement error after 1 to 4 s, a panel per data set and split."""
    shown = parts(rows)
    width = 4.0 * len(shown) + 0.6
    columns = max(2, int(width / 2.1))
    legend_rows = -(-len(predictors(rows)) // columns)
    figure = Figure(figsize=(width, 3.6 + 0.2 * legend_rows), layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, part in zip(panels, shown, strict=True):
        for predictor in predictors(rows):
            mine = _of(rows, part, predictor)
            if not mine:
                continue
            means = [_mean(_column(mine, f"fde_{t:g}")) for t in SECONDS]
            axes.plot(
                SECONDS, means, "o-", ms=4, color=colour_of(predictor),
                label=label_of(predictor),
            )  # fmt: skip
        count = len(
            {tuple(r[k] for k in WINDOW) for r in rows if (r["source"], r["split"]) == part}
        )
        axes.set_title(f"{_name(part)}: {count} windows")
        axes.set_xlabel("time ahead [s]")
        axes.set_xticks(SECONDS)
        axes.set_ylim(bottom=0.0)
    panels[0].set_ylabel("mean displacement [m]")
    # Below: a dozen curves that nearly coincide leave no corner free.
    entries = {
        label: line
        for axes in panels
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=columns, fontsize=8
    )
    return save(figure, path)
