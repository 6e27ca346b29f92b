"""Egos in the closed loop: the same crossings for each."""

from __future__ import annotations

import tempfile
from pathlib import Path

from agents import EGOS
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick
from evaluation.metrics.statistics import Interval
from evaluation.rollout.setting import MAX_STEPS
from evaluation.studies.closed_loop import paired_difference, study, summarise


def formatted(interval: Interval) -> str:
    """Mean with its interval."""
    return f"{interval.mean:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has 4 seeds, else 100."""
    seeds = 4 if arguments.quick else 100
    yardstick = Yardstick.measure()
    with tempfile.TemporaryDirectory() as folder:
        trials = study(Path(folder) / "closed_loop", tuple(EGOS), range(seeds))
    rows: list[TableRow] = []
    for ego in EGOS:
        found = summarise(trials, ego)
        rows.append(
            {
                "ego": ego,
                "collisions": found.collisions,
                "goal reached": f"{found.reached} of {found.episodes}",
                "failed": found.failed,
                "smallest distance [m]": f"{found.smallest_distance:.2f}",
                "time to goal [s]": formatted(found.time_to_goal),
                "cost": formatted(found.cost),
                "cost minus oracle's": formatted(paired_difference(trials, ego, "oracle", "cost")),
                "decision p50": yardstick.formatted(found.latency_median / 1e3),
                "decision p99": yardstick.formatted(found.latency_p99 / 1e3),
                "failed plans": found.failed_plans,
                "failed fits": found.failed_fits,
            }
        )
    note = (
        f"Crosswalk, 2 agents, full state with noise std 0.05, {seeds} seeds, the same for each "
        "ego; means with 95 % intervals. Distances are between discs: below 0 is a collision. An "
        f"episode without arrival counts with {MAX_STEPS / 10:g} s. {yardstick.note} Latencies "
        "are taken with one process per core at work."
    )
    return [Result("Egos in the closed loop", note, rows).show(arguments.console)]
