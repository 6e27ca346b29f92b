"""Results of the ETH/UCY protocol: numbers by predictor and scene, tables, CSV and Markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.markup import escape

from evaluation.execution.store import Row
from evaluation.metrics.calibration import BINS, NOMINAL
from evaluation.metrics.ranks import LEAST_GROUPS
from evaluation.metrics.statistics import Interval, stratified_interval
from evaluation.reports.calibration import EXPLANATION, Curve, curve_of, reliability
from evaluation.reports.digits import significant
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.lines import Line, markdown_of, table_of
from evaluation.reports.naming import label_of
from evaluation.reports.published_prediction import ETH_UCY
from evaluation.windows.eth_ucy import SCENES
from foresight_env.files import write_atomically

REFERENCE = "constant-velocity"
"""Predictor that the others are compared with on the same agents."""
BLOCK_SECONDS = 30.0
"""Windows that begin to predict in the same block of time are resampled together. Several times a
window's length (8 s), and short enough for eight blocks in univ (216 s)."""
AVERAGE = "average"
ERRORS = {"ade": "ADE", "fde": "FDE", "best_ade": "minADE20", "best_fde": "minFDE20"}
"""Names of the metrics of rows in tables."""
TOTALS = {
    "collisions": "overlaps",
    "collisions_recorded": "overlaps_recorded",
    "fallbacks": "fallbacks",
}
"""Numbers that are sums over windows, and their columns of rows."""
HEAD = "# ETH/UCY, one scene left out"
RULE = (
    "8 observed and 12 predicted steps of 0.4 s; every window of 20 consecutive steps in which at "
    "least two agents are present throughout; errors in metres, means over agents; the average is "
    "that of the scenes. K = 1: the most likely future. K = 20: the best of at most 20 most likely "
    "futures, for each agent and for ADE and FDE separately."
)
NOTES = (
    f"Brackets: difference to {REFERENCE} on the same agents, 95 % interval, blocks of "
    f"{BLOCK_SECONDS:g} s resampled within each scene; none below {LEAST_GROUPS} blocks. "
    f"NLL: negative log-likelihood per step (density in 1/m^2). {EXPLANATION} Missed: more than "
    "2 m off at the end. Collisions: pairs of agents judged in one history whose discs overlap in "
    "the most likely future, and in the recording. Over all scenes: sums of agents, collisions and "
    "fallbacks, quantiles of all latencies (of a history of up to 8 agents), means of the scenes' "
    "other numbers."
)


class Numbers(NamedTuple):
    """Results of one predictor in one scene, or their average; NaN where there is none."""

    predictor: str
    scene: str
    windows: int
    agents: int
    blocks: int
    ade: float
    fde: float
    best_ade: float
    best_fde: float
    missed: float
    """Share of agents."""
    nll: float
    coverage_50: float
    coverage_90: float
    collisions: int
    collisions_recorded: int
    fallbacks: int
    latency_p50_ms: float
    latency_p99_ms: float
    gaps: dict[str, Interval]
    """Differences to `REFERENCE` by metric, where it has been run."""


def common_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows of the windows that all predictors of a scene have finished, in the order of time."""
    names = {row["predictor"] for row in rows}
    finished: dict[tuple[str, str, int], set[str]] = {}
    for row in rows:
        if not row["error"]:
            finished.setdefault(_window(row), set()).add(row["predictor"])
    kept = [row for row in rows if finished.get(_window(row)) == names]
    return sorted(kept, key=_window)


def _window(row: Row) -> tuple[str, str, int]:
    return row["scene"], row["recording"], row["frame"]


def predictors_of(rows: Sequence[Row]) -> list[str]:
    """Predictors in the order of the rows, the reference first."""
    names = list(dict.fromkeys(row["predictor"] for row in rows))
    return sorted(names, key=lambda name: name != REFERENCE)


def scenes_of(rows: Sequence[Row]) -> list[str]:
    """Scenes in the order of the protocol."""
    return [scene for scene in SCENES if any(row["scene"] == scene for row in rows)]


def numbers(rows: Sequence[Row]) -> list[Numbers]:
    """Return each predictor's numbers in each scene, then their average.

    Windows that a predictor failed in, or has not been run on, are left out for all predictors.
    """
    kept, found = common_rows(rows), []
    scenes = scenes_of(kept)
    for name in predictors_of(kept):
        own = {scene: _rows(kept, name, scene) for scene in scenes}
        reference = {scene: _rows(kept, REFERENCE, scene) for scene in scenes}
        parts = [_scene(name, scene, own[scene], reference[scene]) for scene in scenes]
        found += [*parts, _average(name, parts, own, reference)]
    return found


def _rows(rows: Sequence[Row], predictor: str, scene: str) -> list[Row]:
    return [row for row in rows if (row["predictor"], row["scene"]) == (predictor, scene)]


def _all(rows: Sequence[Row], column: str) -> Float[np.ndarray, "_"]:
    """Entries of all agents, or histories, of all windows."""
    return np.array([value for row in rows for value in row[column] or ()], dtype=float)


def _blocks(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """The block of time of each agent of each window."""
    return [
        (row["recording"], int(row["frame"] / SCENES[row["scene"]].rate // BLOCK_SECONDS))
        for row in rows
        for _ in row["agents"]
    ]


def _mean(values: Float[np.ndarray, "_"]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _scene(name: str, scene: str, rows: Sequence[Row], reference: Sequence[Row]) -> Numbers:
    curve = curve_of([row["levels"] for row in rows])
    blocks = _blocks(rows)
    found: dict[str, Any] = {metric: _mean(_all(rows, metric)) for metric in ERRORS}
    found |= {"missed": _mean(_all(rows, "missed")), "nll": _mean(_all(rows, "nll"))}
    found |= {f"coverage_{100 * q:.0f}": _covered(curve, q) for q in NOMINAL}
    found |= {name: sum(row[column] for row in rows) for name, column in TOTALS.items()}
    return Numbers(
        predictor=name,
        scene=scene,
        windows=len(rows),
        agents=len(blocks),
        blocks=len(set(blocks)),
        gaps=_gaps([rows], [reference]),
        **found,
        **_latencies(rows),
    )


def _latencies(rows: Sequence[Row]) -> dict[str, Any]:
    p50, p99 = np.percentile(1e3 * _all(rows, "seconds"), [50, 99])
    return {"latency_p50_ms": float(p50), "latency_p99_ms": float(p99)}


def _covered(curve: Curve | None, nominal: float) -> float:
    return float("nan") if curve is None else float(curve[round(nominal * BINS) - 1])


def _gaps(rows: Sequence[Sequence[Row]], reference: Sequence[Sequence[Row]]) -> dict[str, Interval]:
    """Differences to the reference on the same agents, over scenes; none for the reference."""
    if not reference[0] or rows[0][0]["predictor"] == REFERENCE:
        return {}
    clusters = [_blocks(own) for own in rows]
    sure = min(len(set(blocks)) for blocks in clusters) >= LEAST_GROUPS
    found = {}
    for metric in ERRORS:
        gap = [_all(a, metric) - _all(b, metric) for a, b in zip(rows, reference, strict=True)]
        interval = stratified_interval(gap, clusters)
        found[metric] = interval if sure else Interval(interval.mean, np.nan, np.nan)
    return found


def _average(
    name: str,
    parts: Sequence[Numbers],
    rows: dict[str, list[Row]],
    reference: dict[str, list[Row]],
) -> Numbers:
    means = (*ERRORS, "missed", "nll", "coverage_50", "coverage_90")
    found: dict[str, Any] = {n: float(np.mean([getattr(p, n) for p in parts])) for n in means}
    sums = ("windows", "agents", "blocks", *TOTALS)
    found |= {n: sum(getattr(p, n) for p in parts) for n in sums}
    return Numbers(
        predictor=name,
        scene=AVERAGE,
        gaps=_gaps(list(rows.values()), list(reference.values())),
        **found,
        **_latencies([row for own in rows.values() for row in own]),
    )


def error_lines(found: Sequence[Numbers], futures: int) -> list[Line]:
    """A line per predictor and per published number: errors by scene, of K = 1 or 20 futures."""
    average, final = ("ade", "fde") if futures == 1 else ("best_ade", "best_fde")
    lines: list[Line] = []
    scenes = list(dict.fromkeys(n.scene for n in found))
    for name in dict.fromkeys(n.predictor for n in found):
        cells = {n.scene: n for n in found if n.predictor == name}
        lines.append(
            {
                f"ADE / FDE [m], K = {futures}": label_of(name),
                **{
                    scene: f"{getattr(cells[scene], average):.2f} / "
                    f"{getattr(cells[scene], final):.2f}"
                    for scene in scenes
                },
            }
        )
    if set(SCENES) <= set(scenes):
        for published in ETH_UCY:
            if published.futures == futures:
                lines.append(
                    {
                        f"ADE / FDE [m], K = {futures}": f"published: {published.label}",
                        **dict.fromkeys(scenes, ""),
                        AVERAGE: f"{published.ade:.2f} / {published.fde:.2f}",
                    }
                )
    return lines


def gap_lines(found: Sequence[Numbers]) -> list[Line]:
    """A line per predictor and metric: difference to the reference by scene, with intervals."""
    lines: list[Line] = []
    scenes = list(dict.fromkeys(n.scene for n in found))
    for name in dict.fromkeys(n.predictor for n in found):
        cells = {n.scene: n.gaps for n in found if n.predictor == name}
        if not cells[AVERAGE]:
            continue
        for metric, label in ERRORS.items():
            lines.append(
                {
                    f"minus {REFERENCE} [m]": label_of(name),
                    "metric": label,
                    **{scene: _interval(cells[scene][metric]) for scene in scenes},
                }
            )
    return lines


def _interval(found: Interval) -> str:
    text = f"{found.mean:+.3f}"
    return text if np.isnan(found.low) else f"{text} [{found.low:+.3f}, {found.high:+.3f}]"


def _cell(value: float, tell: Callable[[float], str]) -> str:
    return "-" if np.isnan(value) else tell(value)


def other_lines(found: Sequence[Numbers]) -> list[Line]:
    """A line per predictor: likelihood, calibration, misses, collisions, latency."""
    return [
        {
            "over all scenes": label_of(n.predictor),
            "agents": n.agents,
            "NLL": _cell(n.nll, lambda v: f"{v:.2f}"),
            "50% region": _cell(n.coverage_50, lambda v: f"{v:.0%}"),
            "90% region": _cell(n.coverage_90, lambda v: f"{v:.0%}"),
            "missed": f"{n.missed:.1%}",
            "collisions (recorded)": f"{n.collisions} ({n.collisions_recorded})",
            "ratio": f"{n.collisions / n.collisions_recorded:.2f}"
            if n.collisions_recorded
            else "-",
            "fallbacks": n.fallbacks,
            "ms, p50 / p99": " / ".join(
                significant(value, 2) for value in (n.latency_p50_ms, n.latency_p99_ms)
            ),
        }
        for n in found
        if n.scene == AVERAGE
    ]


def tables(found: Sequence[Numbers]) -> list[tuple[str, list[Line]]]:
    """Titles and lines of all tables that have any."""
    titled = [
        ("One future", error_lines(found, 1)),
        ("Best of 20 futures", error_lines(found, 20)),
        (f"Difference to {REFERENCE}", gap_lines(found)),
        ("Likelihood, calibration, collisions, latency", other_lines(found)),
    ]
    return [(title, lines) for title, lines in titled if lines]


def _counted(found: Sequence[Numbers], every: int) -> str:
    first = found[0].predictor
    counts = "; ".join(
        f"{n.scene}: {n.agents} agents in {n.windows} windows"
        for n in found
        if n.predictor == first and n.scene != AVERAGE
    )
    return f"{counts}." + (f" This is one window in {every}: not the protocol." * (every > 1))


def _failures(rows: Sequence[Row]) -> str:
    errors = errors_of(rows)
    left_out = "windows of failed predictions are left out for all predictors."
    return f"{failed(errors, 'prediction')}; {left_out}" if errors else ""


def print_eth_ucy(console: Console, rows: Sequence[Row], *, every: int = 1) -> None:
    """Print the tables and what they mean; `every`: of how many windows one was taken."""
    found = numbers(rows)
    if found:
        console.print(escape(_counted(found, every)))
        for title, lines in tables(found):
            console.print(table_of(title, lines))
        console.print(escape(f"{RULE} {NOTES}"))
    if errors := _failures(rows):
        console.print(f"[red]{escape(errors)}[/red]")


def write_csv(rows: Sequence[Row], path: Path) -> Path:
    """Write all numbers: a line per predictor and scene, then the published ones; the path."""
    columns = [name for name in Numbers._fields if name != "gaps"]
    head = columns + [f"{m}_{part}" for m in ERRORS for part in ("gap", "gap_low", "gap_high")]
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow([*head, "source"])
    for n in numbers(rows):
        none = Interval(np.nan, np.nan, np.nan)
        values = [getattr(n, name) for name in columns]
        values += [value for metric in ERRORS for value in n.gaps.get(metric, none)]
        writer.writerow(
            ["" if isinstance(v, float) and np.isnan(v) else v for v in values] + ["measured"]
        )
    for published in ETH_UCY:
        prefix = "" if published.futures == 1 else "best_"
        known = {
            "predictor": published.name,
            "scene": AVERAGE,
            f"{prefix}ade": published.ade,
            f"{prefix}fde": published.fde,
        }
        writer.writerow([known.get(name, "") for name in head] + [f"published: {published.source}"])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, sink.getvalue().encode())
    return path


def write_markdown(rows: Sequence[Row], path: Path, *, every: int = 1) -> Path:
    """Write the results page as Markdown; the path. `every`: of how many windows one was taken."""
    found = numbers(rows)
    parts = [HEAD, "", RULE, "", *([_counted(found, every), ""] if found else [])]
    for title, lines in tables(found):
        parts += [f"## {title}", "", *markdown_of(lines)]
    parts += [NOTES, ""]
    if errors := _failures(rows):
        parts += [errors, ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, "\n".join(parts).encode())
    return path


def curves(rows: Sequence[Row]) -> dict[str, Curve]:
    """Observed coverage by predictor, mean over scenes; of predictors with covariances."""
    kept = common_rows(rows)
    found = {}
    for name in predictors_of(kept):
        each = [
            curve
            for scene in scenes_of(kept)
            if (curve := curve_of([r["levels"] for r in _rows(kept, name, scene)])) is not None
        ]
        if each:
            found[name] = np.mean(each, axis=0)
    return found


def draw_reliability(rows: Sequence[Row], path: Path) -> Path:
    """Draw nominal against observed coverage; `rows`: some of a predictor with covariances."""
    return reliability({"ETH/UCY, average of the scenes": curves(rows)}, path)
