"""Egos that turn left among cars that play the game, or that highway-env drives."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import islice, product
from multiprocessing import get_context
from typing import Any

import numpy as np

from benchmarks.report import Result, Row, Setting
from benchmarks.timing import Yardstick
from evaluation.closed_loop import WARM_UP_STEPS, episode
from evaluation.run_setting import RunSetting
from evaluation.trials import available_workers, single_threaded

EGOS = ("oracle", "foresight", "farsighted", "constant-velocity")
BEHAVIOURS = ("receding", "idm")
SEEDS = 4
"""The full study of all scenes is another matter; these take minutes."""

Trial = tuple[str, str, int]


def drive(trial: Trial) -> dict[str, Any]:
    """One episode of `left_turn` with four cars."""
    ego, behaviour, seed = trial
    setting = RunSetting("driving", behaviour=behaviour)
    for _ in islice(episode(setting.make(), ego, seed, setting.gammas), WARM_UP_STEPS):
        pass
    steps = list(episode(setting.make(), ego, seed, setting.gammas))
    last = steps[-1].info
    places = np.stack([*(s.state[:, :2] for s in steps), last["state"][:, :2]])
    return {
        "trial": trial,
        "collision": last["collision"],
        "reached": last["is_success"],
        "time": last["time"],
        "gap": last["min_distance"],
        "centre": float(np.linalg.norm(places[:, 1:] - places[:, :1], axis=2).min()),
        "latencies": [1e3 * s.latency for s in steps],
        "failed": sum(s.decision.failed for s in steps),
    }


def rows_of(found: list[dict[str, Any]]) -> Iterator[Row]:
    """A line per kind of other drivers and ego."""
    for behaviour, ego in product(BEHAVIOURS, EGOS):
        mine = [f for f in found if f["trial"][:2] == (ego, behaviour)]
        latencies = np.concatenate([f["latencies"] for f in mine])
        reached = [f["time"] for f in mine if f["reached"]]
        yield {
            "others": behaviour,
            "ego": ego,
            "episodes": len(mine),
            "collisions": sum(f["collision"] for f in mine),
            "goal reached": sum(f["reached"] for f in mine),
            "smallest gap of boxes [m]": f"{min(f['gap'] for f in mine):.2f}",
            "smallest distance of middles, mean (least) [m]": (
                f"{np.mean([f['centre'] for f in mine]):.1f} ({min(f['centre'] for f in mine):.1f})"
            ),
            "time to goal [s]": f"{np.mean(reached):.2f}" if reached else "-",
            "failed plans": sum(f["failed"] for f in mine),
            "decision p50, p99 [ms]": (
                f"{np.percentile(latencies, 50):.0f}, {np.percentile(latencies, 99):.0f}"
            ),
        }


def run(setting: Setting) -> list[Result]:
    """The study; `quick` has one seed."""
    yardstick = Yardstick.measure()
    seeds = range(1 if setting.quick else SEEDS)
    trials = [(e, b, s) for b, e, s in product(BEHAVIOURS, EGOS, seeds)]
    with ProcessPoolExecutor(
        available_workers(), get_context("spawn"), initializer=single_threaded
    ) as pool:
        found = list(pool.map(drive, trials))
    note = (
        f"Scene left_turn, 4 cars, full states with noise std 0.1, seeds 0 to {len(seeds) - 1}; "
        "gammas of others uniform in (0.7, 1). 50 steps at most. One process per core at work. "
        f"{yardstick.note}"
    )
    return [Result("Driving: the left turn", note, list(rows_of(found))).show(setting.console)]
