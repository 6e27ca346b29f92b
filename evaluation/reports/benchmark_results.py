"""Summary of the benchmark's rows: means with intervals and ranks, for tables, page and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evaluation.execution.store import Row
from evaluation.metrics.calibration import BINS, coverage
from evaluation.metrics.ranks import Rank, ranks
from evaluation.metrics.statistics import Interval, clustered_interval, share_interval
from evaluation.reports.naming import label_of
from foresight_env.files import write_atomically

OPEN, CLOSED = "open loop", "closed loop"


class Metric(NamedTuple):
    """A column of a table."""

    name: str
    unit: str
    description: str
    """Description in the page's legend."""
    ranked: bool = False
    """Whether methods are ranked by it; less is better."""
    share: bool = False
    """Whether each case has it or not."""


ADE = Metric("ADE", "m", "mean distance between prediction and truth", True)
FDE = Metric("FDE", "m", "the same at the last step at which an agent is there")
MISSED = Metric("missed", "%", "agents predicted more than 2 m off at that step")
BEST = Metric("best of 5", "m", "ADE of the best of the five most likely joint futures")
COVERED_50 = Metric(
    "50 % region", "%", "true positions in the regions given 50 % probability, mean over windows"
)
COVERED_90 = Metric("90 % region", "%", "the same of 90 %")
COLLISIONS_PREDICTED = Metric(
    "predicted collisions", "", "pairs whose footprints overlap in the forecast"
)
COLLISIONS_TRUE = Metric("true collisions", "", "pairs whose footprints overlap in the truth")
NLL = Metric("NLL", "", "minus the log of the probability density (1/m^2) given to the truth")
HARM = Metric("collided", "%", "episodes that ended in a collision or off the road", True, True)
REACHED = Metric("goal", "%", "episodes in which the ego reached its goal unharmed", share=True)
TIME = Metric(
    "time to goal", "s", "the time limit where it was not reached, or where the ego collided", True
)
COST = Metric("cost", "", "the ego's own undiscounted cost over time, collisions left out")
GAP = Metric("least gap", "m", "least distance between footprints, negative where they overlap")
AHEAD = Metric("1 s ahead", "m", "how far off the ego's own predictions of others were after 1 s")
P50 = Metric("p50", "ms", "median time of a prediction or decision, without compilation")
P99 = Metric("p99", "ms", "99th percentile of it")
FAILED = Metric("failed", "", "predictions replaced by the fallback, constant velocity; an ego's"
                " plans and fits that failed")  # fmt: skip
FAILED_TRIALS = Metric("failed trials", "", "trials that raised an exception")

OPEN_METRICS = (
    ADE, FDE, MISSED, BEST, NLL, COVERED_50, COVERED_90, COLLISIONS_PREDICTED, COLLISIONS_TRUE,
    P50, P99, FAILED, FAILED_TRIALS,
)  # fmt: skip
CLOSED_METRICS = (HARM, REACHED, TIME, COST, GAP, AHEAD, P50, P99, FAILED, FAILED_TRIALS)


class Value(NamedTuple):
    """A cell: a mean with its 95 % interval where that means something, and a rank."""

    mean: float
    low: float = float("nan")
    high: float = float("nan")
    rank: Rank | None = None


class MethodResult(NamedTuple):
    """One method at one place."""

    method: str
    cases: int
    """Windows, or episodes."""
    values: dict[str, Value]
    """By the metric's name."""
    errors: tuple[str, ...] = ()
    """Of the trials that failed."""


class PlaceResult(NamedTuple):
    """All methods at one place, best first."""

    loop: str
    place: str
    cases: str
    """Unit of the counted cases."""
    metrics: tuple[Metric, ...]
    lines: tuple[MethodResult, ...]


Cases = list[tuple[Hashable, Row]]
"""A method's windows or episodes with the cluster that each belongs to, in a common order."""


def open_part(
    place: str, methods: dict[str, Cases], errors: Mapping[str, Sequence[str]]
) -> PlaceResult:
    """Predictions at one place; every method has the same windows."""
    columns: dict[Metric, Callable[[Row], float]] = {
        ADE: lambda r: r["average_error"],
        FDE: lambda r: r["final_error"],
        MISSED: lambda r: 100.0 * r["missed"] / r["agents"],
        BEST: lambda r: r["best_average_error"],
        NLL: lambda r: _number(r["nll"]),
        COVERED_50: lambda r: _covered(r["levels"], 0.5),
        COVERED_90: lambda r: _covered(r["levels"], 0.9),
    }
    lines = _lines(
        methods,
        errors,
        columns,
        (ADE,),
        {COLLISIONS_PREDICTED: "overlaps", COLLISIONS_TRUE: "overlaps_recorded"},
    )
    return PlaceResult(OPEN, place, "windows", OPEN_METRICS, _sorted(lines, ADE))


def _covered(levels: Sequence[int] | None, nominal: float) -> float:
    """Share of positions in a region, %; NaN of forecasts without one."""
    if levels is None:
        return float("nan")
    return 100.0 * float(coverage([levels])[round(nominal * BINS) - 1])


def class_part(place: str, methods: dict[str, Cases]) -> PlaceResult:
    """Displacement errors of the agents of a class; every method has the same agents."""
    columns: dict[Metric, Callable[[Row], float]] = {ADE: lambda r: r["average_error"]}
    lines = _lines(methods, {}, columns, (ADE,))
    return PlaceResult(OPEN, place, "agents", (ADE,), _sorted(lines, ADE))


def closed_part(
    place: str, methods: dict[str, Cases], errors: Mapping[str, Sequence[str]]
) -> PlaceResult:
    """Driving at one place; every method has the same seeds."""
    columns: dict[Metric, Callable[[Row], float]] = {
        HARM: lambda r: 100.0 * (r["collision"] or r["off_road"]),
        REACHED: lambda r: 100.0 * r["goal_reached"],
        TIME: lambda r: r["time"] if r["goal_reached"] else r["time_limit"],
        COST: lambda r: float("nan") if r["collision"] or r["off_road"] else r["cost"],
        GAP: lambda r: r["min_gap"],
        AHEAD: lambda r: _number(r["prediction_error"]),
    }
    lines = _lines(methods, errors, columns, (HARM, TIME))
    return PlaceResult(CLOSED, place, "episodes", CLOSED_METRICS, _sorted(lines, HARM, TIME))


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _sorted(lines: list[MethodResult], *metrics: Metric) -> tuple[MethodResult, ...]:
    def key(line: MethodResult) -> list[float]:
        means = [line.values[m.name].mean for m in metrics]
        return [np.inf if np.isnan(mean) else mean for mean in means]

    return tuple(sorted(lines, key=key))


def _lines(
    methods: dict[str, Cases],
    errors: Mapping[str, Sequence[str]],
    columns: dict[Metric, Callable[[Row], float]],
    ranked: tuple[Metric, ...],
    counted: Mapping[Metric, str] = MappingProxyType({}),
) -> list[MethodResult]:
    """A line per method that has cases; methods without any have their failed trials.

    `columns` become means, `counted` sums of the rows' entries of that name.
    """
    full = {name: cases for name, cases in methods.items() if cases}
    clusters = [cluster for cluster, _ in next(iter(full.values()), [])]
    values = {
        metric: {
            name: np.array([column(row) for _, row in cases], dtype=float)
            for name, cases in full.items()
        }
        for metric, column in columns.items()
    }
    places: dict[Metric, dict[str, Rank]] = {}
    for metric in ranked:
        if full:
            found = ranks(np.stack(list(values[metric].values())), clusters)
            places[metric] = dict(zip(full, found, strict=True))
    lines = []
    for name in methods:
        mine = tuple(errors.get(name, ()))
        if name not in full:
            empty = {metric.name: Value(float("nan")) for metric in columns}
            values_of = {**empty, FAILED_TRIALS.name: Value(float(len(mine)))}
            lines.append(MethodResult(name, 0, values_of, mine))
            continue
        cells = {
            metric.name: _value(
                metric, values[metric][name], clusters, places.get(metric, {}).get(name)
            )
            for metric in columns
        }
        rows = [row for _, row in full[name]]
        times = 1e3 * np.concatenate([row["seconds"] for row in rows])
        cells[P50.name], cells[P99.name] = (Value(float(q)) for q in np.percentile(times, [50, 99]))
        for metric, entry in {FAILED: "failed", **counted}.items():
            cells[metric.name] = Value(float(sum(row[entry] for row in rows)))
        cells[FAILED_TRIALS.name] = Value(float(len(mine)))
        lines.append(MethodResult(name, len(rows), cells, mine))
    return lines


def _value(
    metric: Metric,
    values: Float[np.ndarray, "n"],
    clusters: Sequence[Hashable],
    rank: Rank | None,
) -> Value:
    if metric.share:
        share = share_interval(values > 0.0)
        return Value(100.0 * share.mean, 100.0 * share.low, 100.0 * share.high, rank)
    there = np.isfinite(values)
    if not there.any():
        return Value(float("nan"))
    kept = [c for c, t in zip(clusters, there, strict=True) if t]
    interval: Interval = clustered_interval(values[there], kept)
    if len(set(map(repr, kept))) < 2:
        return Value(interval.mean, rank=rank)
    return Value(*interval, rank)


def common(methods: dict[str, dict[Hashable, tuple[Hashable, Row]]]) -> dict[str, Cases]:
    """Each method's cases that all methods have which have any, in one order."""
    sets = [set(cases) for cases in methods.values() if cases]
    shared = sorted(set.intersection(*sets), key=repr) if sets else []
    return {
        name: [cases[key] for key in shared] if cases else [] for name, cases in methods.items()
    }


def write_csv(parts: Sequence[PlaceResult], path: Path) -> Path:
    """A line per loop, place, method and metric, methods as tables show them; numbers in full."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        ("loop", "place", "method", "cases", "metric", "unit", "mean", "low_95", "high_95",
         "rank", "rank_low_95", "rank_high_95")
    )  # fmt: skip
    for part in parts:
        units = {metric.name: metric.unit for metric in part.metrics}
        for line in part.lines:
            for name, value in line.values.items():
                if name not in units:
                    continue
                rank = value.rank or ("", "", "")
                told = ["" if np.isnan(v) else repr(float(v)) for v in value[:3]]
                writer.writerow(
                    (
                        part.loop,
                        part.place,
                        label_of(line.method),
                        line.cases,
                        name,
                        units[name],
                        *told,
                        *rank,
                    )
                )
    write_atomically(path, out.getvalue().encode())
    return path
