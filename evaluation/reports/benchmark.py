"""`foresight benchmark`: predictors and egos at every place, judged side by side."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path

from agents.registry import SCENE_PREDICTORS
from evaluation.execution.local import Workers
from evaluation.execution.store import Row
from evaluation.reports.benchmark_page import print_parts, write_page
from evaluation.reports.benchmark_results import (
    PlaceResult,
    closed_part,
    common,
    open_part,
    write_csv,
)
from evaluation.reports.naming import OTHERS
from evaluation.reports.terminal import terminal
from evaluation.rollout.places import is_driving
from evaluation.studies import prediction
from evaluation.studies.benchmark import Plan, closed_study, open_study
from evaluation.windows.table import WINDOW


def benchmark(
    plan: Plan, data: Path | None, split: str, workers: Workers, out: Path
) -> tuple[PlaceResult, ...]:
    """Run what `out` does not have yet; tables, `benchmark.csv` and `benchmark.html` there.

    `data`: recordings for the open loop; None leaves them out. `split`: see `prediction.study`.
    """
    console = terminal()
    recorded: list[Row] = []
    without_game = tuple(name for name in plan.predictors if name not in SCENE_PREDICTORS)
    if data is not None and without_game:
        recorded = prediction.study(
            out / "recorded", data, without_game, split=split, workers=workers
        )
    simulated = open_study(out / "open_loop", plan, workers=workers) if plan.predictors else []
    driven = closed_study(out / "closed_loop", plan, workers=workers) if plan.egos else []
    parts = (
        *recorded_parts(recorded, without_game),
        *simulated_parts(simulated, plan),
        *driven_parts(driven, plan),
    )
    print_parts(console, parts)
    console.print(f"table: {write_csv(parts, out / 'benchmark.csv')}", soft_wrap=True, markup=False)
    page = write_page(parts, out / "benchmark.html", f"split {split}" if recorded else "")
    console.print(f"page: {page}", soft_wrap=True, markup=False)
    return parts


Keyed = dict[Hashable, tuple[Hashable, Row]]


def recorded_parts(rows: Sequence[Row], predictors: Sequence[str]) -> list[PlaceResult]:
    """A part per data set and split."""
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
        found.append(open_part(f"{source.upper()}, {split}", common(methods), errors))
    return found


PER_WINDOW = ("average_error", "final_error", "missed", "best_average_error", "nll")


def simulated_parts(rows: Sequence[Row], plan: Plan) -> list[PlaceResult]:
    """A part per environment; an episode's windows depend on each other."""
    found = []
    for place in plan.places if rows else ():
        methods: dict[str, Keyed] = {name: {} for name in plan.predictors}
        errors: dict[str, list[str]] = {name: [] for name in plan.predictors}
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


def driven_parts(rows: Sequence[Row], plan: Plan) -> list[PlaceResult]:
    """A part per environment and kind of others."""
    found = []
    for place, others in plan.pairs() if rows else ():
        egos = plan.egos_of(place)
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
