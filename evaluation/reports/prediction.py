"""Tables and the picture of predictions on recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape

from evaluation.execution.store import Row
from evaluation.metrics.prediction import SECONDS
from evaluation.metrics.ranks import LEAST_GROUPS
from evaluation.metrics.statistics import clustered_interval
from evaluation.reports.calibration import EXPLANATION, Curve, coverage_cells, curve_of, reliability
from evaluation.reports.digits import significant
from evaluation.reports.failures import failed
from evaluation.reports.figures import save
from evaluation.reports.lines import Line, table_of
from evaluation.reports.naming import colour_of, label_of
from evaluation.windows.table import WINDOW
from foresight_env.games.kinds import is_vehicle

FIRST = ("junction-game", "encounter-game")
"""Which predictor the others are compared with: the first of these that there is."""
REFERENCES = ("constant-velocity", "constant-acceleration")
"""Predictors that each other one is compared with, for people and vehicles alone."""

DataSplit = tuple[str, str]
"""Data set and split."""


def parts(rows: Sequence[Row]) -> list[DataSplit]:
    """Which data sets and splits there are."""
    return sorted({(r["source"], r["split"]) for r in rows})


def _name(part: DataSplit) -> str:
    return f"{part[0].upper()}, {part[1]}"


def predictors(rows: Sequence[Row]) -> list[str]:
    """Which predictors there are, the one that others are compared with first."""
    names = list(dict.fromkeys(r["predictor"] for r in rows))
    first = next((name for name in FIRST if name in names), "")
    return sorted(names, key=lambda name: (name != first, name))


def _of(rows: Sequence[Row], part: DataSplit, predictor: str) -> list[Row]:
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
                    "ratio": _ratio(mine),
                    "fallback": int(_column(mine, "fallback").sum()),
                    "ms, p50 / p99": " / ".join(
                        significant(q, 2) for q in np.percentile(times, [50, 99])
                    ),
                }
            )
    return lines


def _ratio(rows: Sequence[Row]) -> str:
    """Predicted collisions for each recorded one."""
    recorded = _column(rows, "overlaps_recorded").sum()
    return f"{_column(rows, 'overlaps').sum() / recorded:.2f}" if recorded else "-"


def over_time(rows: Sequence[Row]) -> list[Line]:
    """A line per data set, split and predictor: ADE / FDE at the reported times."""
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
            **coverage_cells(curve_of([r["levels"] for r in mine])),
        }
        for part in parts(rows)
        for predictor in predictors(rows)
        if (mine := _of(rows, part, predictor))
    ]


def differences(rows: Sequence[Row]) -> list[Line]:
    """ADE of the first predictor minus each other's, on the same windows."""
    names = predictors(rows)
    lines: list[Line] = []
    for part in parts(rows):
        for other in names[1:]:
            found = paired(rows, part, names[0], other, lambda row: float(row["average_error"]))
            if found:
                lines.append(
                    {"data": _name(part), f"{label_of(names[0])} minus": label_of(other), **found}
                )
    return lines


def class_differences(rows: Sequence[Row]) -> list[Line]:
    """ADE of each predictor minus each reference's, for people and for vehicles alone."""
    lines: list[Line] = []
    names = predictors(rows)
    for part in parts(rows):
        for name, chosen in CLASSES.items():
            for k, other in enumerate(REFERENCES):
                # The difference of two references is shown once.
                for first in (n for n in names if n not in REFERENCES[: k + 1]):
                    found = paired(rows, part, first, other, partial(_class_error, chosen))
                    if found and found["windows"]:
                        lines.append(
                            {
                                "data": _name(part),
                                "class": name,
                                "predictor": label_of(first),
                                "minus": label_of(other),
                                **found,
                            }
                        )
    return lines


def by_recording(rows: Sequence[Row]) -> list[Line]:
    """A line per recording, class of agent and predictor: ADE and FDE, and the reference's gap."""
    lines: list[Line] = []
    for part in parts(rows):
        for recording in dict.fromkeys(r["recording"] for r in rows):
            mine = [r for r in rows if r["recording"] == recording]
            for name, chosen in CLASSES.items():
                for predictor in predictors(mine):
                    errors = _of_class(_of(mine, part, predictor), "agent_errors", chosen)
                    if not len(errors):
                        continue
                    error = partial(_class_error, chosen)
                    gap = (
                        {}
                        if predictor == REFERENCES[0]
                        else paired(mine, part, predictor, REFERENCES[0], error)
                    )
                    lines.append(
                        {
                            "data": _name(part),
                            "recording": recording,
                            "class": name,
                            "predictor": label_of(predictor),
                            "agents": len(errors),
                            "ADE [m]": f"{_mean(errors):.3f}",
                            f"minus {REFERENCES[0]}, by window": gap.get("ADE [m]", ""),
                        }
                    )
    return lines


def _class_error(chosen: Callable[[str], bool], row: Row) -> float:
    """Mean over a window's agents of a class; NaN where there is none."""
    agents = zip(row["agent_errors"], row["kinds"], strict=True)
    return _mean(np.array([e for e, kind in agents if chosen(kind)], dtype=float))


def paired(
    rows: Sequence[Row],
    part: DataSplit,
    first: str,
    second: str,
    error: Callable[[Row], float],
) -> Line:
    """Cells of a comparison of two predictors on the same windows: the first minus the second.

    Windows whose `error` is NaN are left out. Nothing where one of them has not been run.
    """
    mine, other = _of(rows, part, first), _of(rows, part, second)
    if not mine or len(mine) != len(other):
        return {}
    pairs = [(error(a), error(b), str(a["group"])) for a, b in zip(mine, other, strict=True)]
    pairs = [pair for pair in pairs if not np.isnan(pair[:2]).any()]
    groups = [group for *_, group in pairs]
    text = "-"
    if pairs:
        interval = clustered_interval(np.array([a - b for a, b, _ in pairs]), groups)
        text = f"{interval.mean:+.3f}" + (
            f" [{interval.low:+.3f}, {interval.high:+.3f}]"
            if len(set(groups)) >= LEAST_GROUPS
            else " (too few groups)"
        )
    return {
        "windows": len(pairs),
        "groups": len(set(groups)),
        "ADE [m]": text,
        "won": f"{np.mean([a < b for a, b, _ in pairs]):.0%}" if pairs else "-",
    }


def by_class(rows: Sequence[Row]) -> list[Line]:
    """A line per class of agent and predictor: mean ADE, and ADE / FDE at the times."""
    lines: list[Line] = []
    for part in parts(rows):
        for name, chosen in CLASSES.items():
            for predictor in predictors(rows):
                mine = _of(rows, part, predictor)
                errors = _of_class(mine, "agent_errors", chosen)
                if not len(errors):
                    continue
                lines.append(
                    {
                        "data": _name(part),
                        "class": name,
                        "predictor": label_of(predictor),
                        "agents": len(errors),
                        "ADE [m]": f"{_mean(errors):.3f}",
                        **{
                            f"{t:g} s: ADE / FDE [m]": " / ".join(
                                f"{_mean(_of_class(mine, f'agent_{kind}_{t:g}', chosen)):.2f}"
                                for kind in ("ade", "fde")
                            )
                            for t in SECONDS
                        },
                        "lateral acceleration, p99 (recorded) [m/s^2]": " ".join(
                            text.format(_quantile(_of_class(mine, column, chosen)))
                            for text, column in (
                                ("{:.1f}", "agent_lateral_predicted"),
                                ("({:.1f})", "agent_lateral_recorded"),
                            )
                        ),
                    }
                )
    return lines


def _quantile(values: Float[np.ndarray, "n"]) -> float:
    known = values[~np.isnan(values)]
    return float(np.percentile(known, 99)) if known.size else float("nan")


def _of_class(
    rows: Sequence[Row], column: str, chosen: Callable[[str], bool]
) -> Float[np.ndarray, "n"]:
    """A column's entries of the agents of a class."""
    return np.array(
        [
            entry
            for row in rows
            for entry, kind in zip(row[column], row["kinds"], strict=True)
            if chosen(kind)
        ],
        dtype=float,
    )


CLASSES: dict[str, Callable[[str], bool]] = {
    "people": lambda kind: not is_vehicle(kind),
    "vehicles": is_vehicle,
}


def print_prediction(console: Console, rows: Sequence[Row], *, recordings: bool = False) -> None:
    """Print the tables and the first error; `recordings`: also a table of each recording."""
    for title, lines in (
        ("predictions, means over windows", summary(rows)),
        ("errors over time", over_time(rows)),
        ("several futures, and how likely they are", likelihoods(rows)),
        ("on the same windows", differences(rows)),
        ("by class of agent", by_class(rows)),
        ("by class of agent, on the same windows", class_differences(rows)),
        ("by recording and class of agent", by_recording(rows) if recordings else []),
    ):
        for part in dict.fromkeys(line["data"] for line in lines):
            mine = [{k: v for k, v in e.items() if k != "data"} for e in lines if e["data"] == part]
            console.print(table_of(f"{part}: {title}", mine))
    console.print(
        "missed: agents predicted more than 2 m off at the last step they are there. predicted "
        "collisions: pairs whose footprints overlap (recorded: in the recording), and their ratio. "
        "fallback: windows predicted by constant velocity instead. Best of 5: of the five most "
        "likely joint futures the one of least ADE. NLL: negative log-likelihood (density in "
        f"1/m^2) of the ground truth, where a forecast has one; less is better. {EXPLANATION} "
        "Brackets: 95 % intervals, whole groups of windows that share agents resampled."
    )
    errors = [f"{label_of(r['predictor'])}: {r['error']}" for r in rows if r["error"]]
    if errors:
        console.print(f"[red]{escape(failed(errors, 'prediction'))}[/red]")
        console.print("Windows of failed predictions are left out for all predictors.")


def curves(rows: Sequence[Row]) -> dict[str, dict[str, Curve]]:
    """Observed coverage by data set and split, then predictor; of those with covariances."""
    found: dict[str, dict[str, Curve]] = {}
    for part in parts(rows):
        for predictor in predictors(rows):
            curve = curve_of([r["levels"] for r in _of(rows, part, predictor)])
            if curve is not None:
                found.setdefault(_name(part), {})[predictor] = curve
    return found


def draw_reliability(rows: Sequence[Row], path: Path) -> Path:
    """Draw nominal against observed coverage; `rows`: some of a predictor with covariances."""
    return reliability(curves(rows), path)


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
