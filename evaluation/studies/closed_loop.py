"""Egos in the loop: paired seeds, one row per episode.

The ego is player 0 of a crosswalk and knows its discount factor; the others play the
equilibrium of the true game at every step, with discount factors that the ego does not observe.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents import make_ego
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store
from evaluation.metrics.statistics import Interval, mean_interval
from evaluation.rollout.episode import run_episode, warm_up
from evaluation.rollout.setting import MAX_STEPS, RunSetting

KEY = ("ego", "settings", "seed")


@dataclass(frozen=True)
class ClosedLoop:
    """Configuration of the closed-loop study."""

    players: int = 2
    observation: str = "full"
    noise_std: float = 0.05
    behaviour: str = "receding"
    safety_filter: bool = True

    @property
    def run_setting(self) -> RunSetting:
        """One episode's environment."""
        return RunSetting(
            "crosswalk",
            players=self.players,
            observation=self.observation,
            noise_std=self.noise_std,
            behaviour=self.behaviour,
            safety_filter=self.safety_filter,
        )


def run_trial(ego: str, settings: str, seed: int, **configuration: Any) -> Row:
    """One episode's row; `settings` distinguishes egos of the same name in the store."""
    setting = ClosedLoop(**configuration).run_setting
    warm_up(setting, ego)
    found = run_episode(setting, ego, seed)
    last, true = found.last, found.last["gamma"]
    decided = found.steps[-1].decision.gammas
    errors = [abs(mean - true[j]) for j, (mean, _) in decided.items() if ego != "oracle"]
    return {
        "collision": bool(last["collision"]),
        "goal_reached": bool(last["goal_reached"]) and not last["collision"],
        "time_out": not last["collision"] and not last["goal_reached"],
        "time": float(last["time"]),
        "min_distance": float(last["min_distance"]),
        "cost": found.cost,
        **found.counts,
        "gamma_error": float(np.mean(errors)) if errors else None,
        "latencies": found.latencies,
    }


def study(
    folder: str | Path,
    egos: tuple[str, ...],
    seeds: range,
    setting: ClosedLoop = ClosedLoop(),
    *,
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder`, where every ego meets every seed.

    Episodes that the folder has already are not run again, unless `fresh`.
    """
    store = Store(folder, "closed loop", setting.__dict__, KEY, fresh=fresh)
    settings = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials = [
        {"ego": ego, "settings": settings[ego], "seed": seed, **setting.__dict__}
        for seed in seeds
        for ego in egos
    ]
    return run_trials(
        run_trial, trials, store, workers=workers, label="closed loop", programs=("ego",)
    )


class ClosedLoopSummary(NamedTuple):
    """One ego's line of the table."""

    ego: str
    episodes: int
    collisions: int
    reached: int
    time_outs: int
    failed: int
    """Trials that raised an exception."""
    min_distance: Interval
    """Over episodes, of the smallest signed distance between discs, m."""
    smallest_distance: float
    time_to_goal: Interval
    """Seconds; episodes that did not reach the goal count with the full `MAX_STEPS`."""
    cost: Interval
    """Undiscounted cost, integrated over time, of the episodes without a collision: a collision
    ends an episode, and what it would have cost with it."""
    latency_median: float
    """Milliseconds per decision, without compilation."""
    latency_p99: float
    interventions: int
    """Decisions whose action the safety filter replaced."""
    failed_plans: int
    """Decisions without a solved plan: the one before was continued, or the ego braked."""
    failed_fits: int
    """Decisions with an older estimate, because the latest fit failed."""


def summarise(rows: list[Row], ego: str, dt: float = 0.1) -> ClosedLoopSummary:
    """Aggregate one ego's episodes; raises `ValueError` when it has none."""
    mine = [r for r in rows if r["ego"] == ego]
    good = [r for r in mine if not r["error"]]
    if not good:
        raise ValueError(
            f"ego {ego}: no episode finished: {mine[0]['error'] if mine else 'no rows'}"
        )
    times = np.array([r["time"] if r["goal_reached"] else MAX_STEPS * dt for r in good])
    distance = np.array([r["min_distance"] for r in good])
    latency = np.concatenate([np.asarray(r["latencies"]) for r in good])
    return ClosedLoopSummary(
        ego,
        len(mine),
        sum(r["collision"] for r in good),
        sum(r["goal_reached"] for r in good),
        sum(r["time_out"] for r in good),
        len(mine) - len(good),
        mean_interval(distance),
        float(distance.min()),
        mean_interval(times),
        mean_interval(np.array([r["cost"] for r in good if not r["collision"]] or [np.inf])),
        float(np.median(latency)),
        float(np.percentile(latency, 99)),
        sum(r["interventions"] for r in good),
        sum(r["failed_plans"] for r in good),
        sum(r["failed_fits"] for r in good),
    )


def paired_difference(
    rows: list[Row], ego: str, other: str, column: str, *, with_collisions: bool = True
) -> Interval | None:
    """Mean of `ego` minus `other` in one column over the seeds that both finished; None of none."""
    values: dict[str, dict[int, float]] = {ego: {}, other: {}}
    for row in rows:
        if row["ego"] in values and not row["error"]:
            if row["collision"] and not with_collisions:
                continue
            values[row["ego"]][row["seed"]] = float(row[column])
    both = sorted(values[ego].keys() & values[other].keys())
    if not both:
        return None
    return mean_interval(np.array([values[ego][s] - values[other][s] for s in both]))
