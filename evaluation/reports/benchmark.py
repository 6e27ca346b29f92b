"""`foresight benchmark`: predictors and egos at every place, judged side by side."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path

from agents.registry import SCENE_PREDICTORS
from evaluation.execution.local import Workers
from evaluation.execution.store import Row
from evaluation.reports.benchmark_page import print_parts, write_page
from evaluation.reports.benchmark_results import (
    Cases,
    PlaceResult,
    class_part,
    closed_part,
    common,
    open_part,
    write_csv,
)
from evaluation.reports.leaderboard import write_leaderboard
from evaluation.reports.naming import OTHERS
from evaluation.reports.prediction import CLASSES
from evaluation.reports.terminal import terminal
from evaluation.rollout.places import is_driving
from evaluation.studies import prediction
from evaluation.studies.benchmark import (
    PER_WINDOW,
    BenchmarkConfiguration,
    closed_study,
    open_study,
)
from evaluation.windows.table import WINDOW


def benchmark(
    configuration: BenchmarkConfiguration,
    data: Path | None,
    split: str,
    workers: Workers,
    out: Path,
) -> tuple[PlaceResult, ...]:
    """Run what `out` does not have yet; tables, `benchmark.csv` and pages there.

    The pages are `benchmark.html` and, as Markdown with ranks first, `leaderboard.md`.

    `data`: recordings for the open loop; None leaves them out. `split`: see `prediction.study`.
    """
    console = terminal()
    recorded: list[Row] = []
    without_game = tuple(name for name in configuration.predictors if name not in SCENE_PREDICTORS)
    if data is not None and without_game:
        recorded = prediction.study(
            out / "recorded", data, without_game, split=split, workers=workers
        )
    simulated = (
        open_study(out / "open_loop", configuration, workers=workers)
        if configuration.predictors
        else []
    )
    driven = (
        closed_study(out / "closed_loop", configuration, workers=workers)
        if configuration.egos
        else []
    )
    parts = (
        *recorded_parts(recorded, without_game),
        *simulated_parts(simulated, configuration),
        *driven_parts(driven, configuration),
    )
    print_parts(console, parts)
    table = write_csv(parts, out / "benchmark.csv")
    console.print(f"table: {table}", soft_wrap=True, markup=False)
    page = write_page(parts, out / "benchmark.html", f"split {split}" if recorded else "")
    board = write_leaderboard(out, out / "leaderboard.md")
    for path in (page, board):
        console.print(f"page: {path}", soft_wrap=True, markup=False)
    return parts


Keyed = dict[Hashable, tuple[Hashable, Row]]


def recorded_parts(rows: Sequence[Row], predictors: Sequence[str]) -> list[PlaceResult]:
    """Parts of each data set and split: all agents, people alone, vehicles alone."""
    found = []
    for source, split in sorted({(r["source"], r["split"]) for r in rows}):
        methods: dict[str, Keyed] = {name: {} for name in predictors}
        errors: dict[str, list[str]] = {name: [] for name in predictors}
        for row in rows:
            if (row["source"], row["split"]) != (source, split):
                continue
            if row["error"]:
                errors[row["predictor"]].append(row["error"])
                continue
            case = {
                **row,
                "agents": len(row["kinds"]),
                "seconds": [row["seconds"]],
                "failed": int(row["fallback"]),
            }
            methods[row["predictor"]][tuple(row[k] for k in WINDOW)] = row["group"], case
        name = f"{source.upper()}, {split}"
        found.append(open_part(name, common(methods), errors))
        classes = [class_part(f"{name}, {kind}", _agents(methods, kind)) for kind in CLASSES]
        found += [part for part in classes if any(line.cases for line in part.lines)]
    return found


def _agents(methods: dict[str, Keyed], kind: str) -> dict[str, Cases]:
    """The agents of a class, each a separate case."""
    agents: dict[str, Keyed] = {name: {} for name in methods}
    for name, cases in methods.items():
        for window, (cluster, row) in cases.items():
            for k, error in enumerate(row["agent_errors"]):
                if CLASSES[kind](row["kinds"][k]):
                    agents[name][window, k] = cluster, {**row, "average_error": error}
    return common(agents)


def simulated_parts(
    rows: Sequence[Row], configuration: BenchmarkConfiguration
) -> list[PlaceResult]:
    """A part per environment; an episode's windows depend on each other."""
    found = []
    for place in configuration.places if rows else ():
        methods: dict[str, Keyed] = {name: {} for name in configuration.predictors}
        errors: dict[str, list[str]] = {name: [] for name in configuration.predictors}
        for row in rows:
            if row["place"] != place:
                continue
            if row["error"]:
                errors[row["predictor"]].append(row["error"])
                continue
            for k, seconds in enumerate(row["seconds"]):
                case = {name: row[name][k] for name in PER_WINDOW}
                case |= {"agents": row["agents"][k], "seconds": [seconds]}
                case |= {"failed": int(row["fallback"][k])}
                methods[row["predictor"]][(row["seed"], k)] = row["seed"], case
        found.append(open_part(place, common(methods), errors))
    return found


def driven_parts(rows: Sequence[Row], configuration: BenchmarkConfiguration) -> list[PlaceResult]:
    """A part per environment and kind of others."""
    found = []
    for place, others in configuration.pairs() if rows else ():
        egos = configuration.egos_of(place)
        methods: dict[str, Keyed] = {name: {} for name in egos}
        errors: dict[str, list[str]] = {name: [] for name in egos}
        for row in rows:
            if (row["place"], row["others"]) != (place, others):
                continue
            if row["error"]:
                errors[row["ego"]].append(row["error"])
                continue
            case = {
                **row,
                "seconds": [1e-3 * t for t in row["latencies"]],
                "failed": row["failed_plans"] + row["failed_fits"],
            }
            methods[row["ego"]][row["seed"]] = row["seed"], case
        name = f"{place}, among {OTHERS[others]}" if is_driving(place) else place
        found.append(closed_part(name, common(methods), errors))
    return found
