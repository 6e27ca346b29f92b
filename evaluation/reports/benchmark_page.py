"""The benchmark for readers: on the terminal, and as one page that needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.reports.benchmark_results import (
    CLOSED,
    OPEN,
    MethodResult,
    Metric,
    PlaceResult,
    Value,
)
from evaluation.reports.digits import significant
from evaluation.reports.failures import failed
from evaluation.reports.naming import label_of
from foresight_env import __version__
from foresight_env.files import write_atomically

INTERVALS = ("ADE", "time to goal", "collided")
"""Metrics that are shown with their interval; the CSV has all of them."""


def number(value: float, unit: str) -> str:
    """As many digits as mean something."""
    if np.isnan(value):
        return "-"
    if unit == "ms":
        return significant(value, 2)
    if unit == "%" or float(value).is_integer():
        return f"{value:.0f}"
    return f"{value:.2f}"


def interval(value: Value, unit: str) -> str:
    """The mean with its interval, where it has one."""
    text = number(value.mean, unit)
    if np.isnan(value.low):
        return text
    return f"{text} [{number(value.low, unit)}, {number(value.high, unit)}]"


def cell(line: MethodResult, metric: Metric) -> str:
    """Text of a metric's value in a table."""
    value = line.values.get(metric.name, Value(float("nan")))
    if metric.name in INTERVALS:
        return interval(value, metric.unit)
    return number(value.mean, metric.unit)


def rank(value: Value) -> str:
    """A rank with the ranks that the data leave possible."""
    if value.rank is None:
        return "-"
    place, low, high = value.rank
    return f"{place}" if low == high else f"{place} ({low}-{high})"


def header(metric: Metric) -> str:
    """Name and unit."""
    return f"{metric.name} [{metric.unit}]" if metric.unit else metric.name


ON_TERMINAL = ("ADE", "NLL", "collided", "time to goal", "1 s ahead")
"""Columns that fit in 80 characters; the page and the CSV have the rest."""


def print_parts(
    console: Console, parts: Sequence[PlaceResult], *, everything: bool = False
) -> None:
    """One table per part, best first; with `everything`, of all metrics."""
    for part in parts:
        table = Table(title=f"{part.loop}: {title(part)}")
        table.add_column("method")
        shown = [m for m in part.metrics if m.name in ON_TERMINAL or everything]
        ranked = [m for m in part.metrics if m.ranked][-1]
        table.add_column("rank", justify="right")
        for metric in shown:
            table.add_column(escape(header(metric)), justify="right")
        table.add_column(escape("[ms] p50 / p99"), justify="right")
        for line in part.lines:
            missing = Value(float("nan"))
            times = [number(line.values.get(p, missing).mean, "ms") for p in ("p50", "p99")]
            table.add_row(
                escape(label_of(line.method)),
                rank(line.values[ranked.name]),
                *(escape(cell(line, m)) for m in shown),
                " / ".join(times),
            )
        console.print(table)
        for line in part.lines:
            if line.errors:
                text = f"{label_of(line.method)}: {failed(line.errors)}"
                console.print(f"[red]{escape(text)}[/red]")
    console.print(
        "Best first; closed loop: by collisions, then by time to goal, which counts the time limit "
        "where the goal was not reached unharmed and gives the rank. Brackets: 95 % intervals of "
        "means. Parentheses: ranks that the data leave possible at 95 %."
    )


def title(part: PlaceResult) -> str:
    """Place and number of cases."""
    counts = sorted({line.cases for line in part.lines if line.cases})
    place = part.place.replace("_", " ")
    return f"{place[0].upper()}{place[1:]}: {counts[0] if counts else 'no'} {part.cases}"


def _any_failed(part: PlaceResult) -> bool:
    return any(line.errors for line in part.lines)


def write_page(parts: Sequence[PlaceResult], path: Path, subtitle: str) -> Path:
    """One self-contained page, open loop and closed loop side by side."""
    templates = Environment(
        loader=PackageLoader("evaluation.reports"), autoescape=True, undefined=StrictUndefined
    )
    templates.filters |= {"label": label_of, "rank": rank, "header": header, "title": title}
    metrics = {m.name: m for part in parts for m in part.metrics}
    text = templates.get_template("benchmark.html").render(
        columns=[(loop, [p for p in parts if p.loop == loop]) for loop in (OPEN, CLOSED)],
        metrics=list(metrics.values()),
        cell=cell,
        span=span,
        any_failed=_any_failed,
        subtitle=subtitle,
        version=__version__,
    )
    write_atomically(path, text.encode())
    return path


def span(
    part: PlaceResult, line: MethodResult, metric: Metric
) -> tuple[float, float, float] | None:
    """Position of a mean and its interval between the least and greatest of a column, 0 to 100.

    None where there is nothing to show.
    """
    values = [other.values[metric.name] for other in part.lines]
    ends = np.array([[v.mean, v.low, v.high] for v in values])
    if np.isnan(ends).all():
        return None
    low, high = float(np.nanmin(ends)), float(np.nanmax(ends))
    mine = np.array(line.values[metric.name][:3])
    if np.isnan(mine[0]) or high - low <= 0.0:
        return None
    mine = np.where(np.isnan(mine), mine[0], mine)
    left, middle, right = 100.0 * (mine[[1, 0, 2]] - low) / (high - low)
    return float(left), float(middle), float(right)
