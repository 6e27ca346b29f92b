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

FIRST = ("junction-game", "encounter-game")
"""Which predictor the others are compared with: the first of these that there is."""

DataSplit = tuple[str, str]
"""Data set and split."""
Line = dict[str, str | int]
"""Of a table: cells by column."""


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
                    "fallback": int(_column(mine, "fallback").sum()),
                    "ms, p50 / p99": " / ".join(
                        significant(q, 2) for q in np.percentile(times, [50, 99])
                    ),
                }
            )
    return lines


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
        }
        for part in parts(rows)
        for predictor in predictors(rows)
        if (mine := _of(rows, part, predictor))
    ]


def differences(rows: Sequence[Row]) -> list[Line]:
    """ADE of the first predictor minus each other's, on the same windows."""
    return _differences(rows, "ADE [m]", lambda row: float(row["average_error"]))


def class_differences(rows: Sequence[Row]) -> list[Line]:
    """The same for vehicles and for people alone: mean over a window's agents of the class."""
    lines: list[Line] = []
    for name, chosen in CLASSES.items():

        def error(row: Row, chosen: Callable[[str], bool] = chosen) -> float:
            agents = zip(row["agent_errors"], row["kinds"], strict=True)
            return _mean(np.array([e for e, kind in agents if chosen(kind)], dtype=float))

        lines += [{"class": name, **line} for line in _differences(rows, "ADE [m]", error)]
    return lines


def _differences(rows: Sequence[Row], column: str, error: Callable[[Row], float]) -> list[Line]:
    lines: list[Line] = []
    for part in parts(rows):
        names = predictors(rows)
        first = _of(rows, part, names[0])
        for other in names[1:]:
            second = _of(rows, part, other)
            if not first or len(first) != len(second):
                continue
            pairs = [
                (error(a), error(b), str(a["group"])) for a, b in zip(first, second, strict=True)
            ]
            pairs = [pair for pair in pairs if not np.isnan(pair[:2]).any()]
            text = "-"
            if pairs:
                gap = np.array([a - b for a, b, _ in pairs])
                groups = [group for *_, group in pairs]
                interval = clustered_interval(gap, groups)
                text = f"{interval.mean:+.3f}" + (
                    f" [{interval.low:+.3f}, {interval.high:+.3f}]"
                    if len(set(groups)) >= LEAST_GROUPS
                    else " (too few groups)"
                )
            lines.append(
                {
                    "data": _name(part),
                    f"{label_of(names[0])} minus": label_of(other),
                    "windows": len(pairs),
                    "groups": len({group for *_, group in pairs}),
                    column: text,
                    "won": f"{np.mean([a < b for a, b, _ in pairs]):.0%}" if pairs else "-",
                }
            )
    return lines


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


def print_prediction(console: Console, rows: Sequence[Row]) -> None:
    """Print the tables and the first error."""
    for title, lines in (
        ("predictions, means over windows", summary(rows)),
        ("errors over time", over_time(rows)),
        ("several futures, and how likely they are", likelihoods(rows)),
        ("on the same windows", differences(rows)),
        ("by class of agent", by_class(rows)),
        ("by class of agent, on the same windows", class_differences(rows)),
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
