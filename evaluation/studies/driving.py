"""Egos on highway-env's roads, in the loop: paired noise seeds, one row per episode.

The ego is car 0; the others play the game, or are highway-env's IDM/MOBIL vehicles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agents import make_ego
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store
from evaluation.metrics.statistics import Interval, mean_interval
from evaluation.metrics.trajectory import at_fault, comfort
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, TIME_OUT, ending, time_to_goal
from evaluation.rollout.episode import run_episode, warm_up
from evaluation.rollout.setting import EGO_CAR, RunSetting

KEY = ("scene", "others", "ego", "settings", "seed")


@dataclass(frozen=True)
class DrivingConfiguration:
    """Configuration of the study."""

    cars: int = 4
    noise_std: float = 0.1
    observation: str = "full"
    safety_filter: bool = True

    def of(self, scene: str, others: str) -> RunSetting:
        """One episode's environment."""
        return RunSetting(
            "driving",
            scene,
            self.cars,
            self.observation,
            self.noise_std,
            others,
            safety_filter=self.safety_filter,
        )


def run_trial(
    scene: str, others: str, ego: str, settings: str, seed: int, **configuration: object
) -> Row:
    """One episode's row; `settings` distinguishes egos of the same name in the store."""
    configured = DrivingConfiguration(**configuration)  # type: ignore[arg-type]
    setting = configured.of(scene, others)
    warm_up(setting, ego)
    found = run_episode(setting, ego, seed)
    last, states = found.last, found.states
    own, goal = states[:, EGO_CAR], last["theta"]["goal"][EGO_CAR]
    nearest = np.linalg.norm(np.delete(states, EGO_CAR, 1)[..., :2] - own[:, None, :2], axis=2)
    ended = ending(last)
    ride = comfort(own, found.dt)
    return {
        "ended": ended,
        "at_fault": ended == COLLISION and at_fault(states[-1], EGO_CAR),
        "time": float(last["time"]),
        "time_limit": found.time_limit,
        "min_gap": float(last["min_distance"]),
        "min_distance": float(nearest.min()),
        "distances": nearest.min(axis=1).tolist(),
        "goal_distances": np.linalg.norm(own[:, :2] - goal, axis=1).tolist(),
        **{f"rms_{name}": value for name, value in ride._asdict().items()},
        **found.counts,
        "latencies": found.latencies,
    }


def study(
    folder: str | Path,
    scenes: Sequence[str],
    others: Sequence[str],
    egos: Sequence[str],
    seeds: range,
    setting: DrivingConfiguration = DrivingConfiguration(),
    *,
    workers: Workers = None,
) -> list[Row]:
    """Run the study in `folder`, where in every scene every ego meets every seed.

    Episodes that the folder has already are not run again.
    """
    store = Store(folder, "driving", asdict(setting), KEY)
    settings = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials = [
        {
            "scene": scene,
            "others": other,
            "ego": ego,
            "settings": settings[ego],
            "seed": seed,
            **asdict(setting),
        }
        for seed in seeds
        for scene in scenes
        for other in others
        for ego in egos
    ]
    return run_trials(
        run_trial,
        trials,
        store,
        workers=workers,
        label="driving",
        programs=("scene", "others", "ego"),
    )


class DrivingSummary(NamedTuple):
    """One ego among one kind of others in one scene."""

    ego: str
    episodes: int
    ends: dict[str, int]
    """How many episodes ended how."""
    faults: int
    """Collisions that the ego caused."""
    failed: int
    """Trials that raised an exception."""
    gap: Interval
    """Over episodes, of the smallest gap between boxes, m."""
    least_gap: float
    distance: Interval
    """Over episodes, of the smallest distance between middles, m."""
    least_distance: float
    time: Interval
    """Seconds to the goal; episodes that did not reach it count with the time limit."""
    rides: dict[str, float]
    """Means of the root mean squares of `Comfort`."""
    latencies: tuple[float, float]
    """Median and 99th percentile per decision, ms, without compilation."""
    interventions: int
    """Decisions whose action the safety filter replaced."""
    failed_plans: int
    failed_fits: int
    oracle_failures: int
    """Steps at which the others' own game was not solved."""


def good_rows(rows: Sequence[Row], scene: str, others: str, ego: str) -> list[Row]:
    """Finished episodes of one ego among one kind of others in one scene."""
    wanted = (scene, others, ego)
    return [r for r in rows if (r["scene"], r["others"], r["ego"]) == wanted and not r["error"]]


def summarise(rows: Sequence[Row], scene: str, others: str, ego: str) -> DrivingSummary | None:
    """Aggregate; None when no episode finished."""
    good = good_rows(rows, scene, others, ego)
    if not good:
        return None
    gap = np.array([r["min_gap"] for r in good])
    distance = np.array([r["min_distance"] for r in good])
    latency = np.concatenate([np.asarray(r["latencies"]) for r in good])
    wanted = (scene, others, ego)
    return DrivingSummary(
        ego,
        len(good),
        {e: sum(r["ended"] == e for r in good) for e in (COLLISION, OFF_ROAD, REACHED, TIME_OUT)},
        sum(r["at_fault"] for r in good),
        sum((r["scene"], r["others"], r["ego"]) == wanted and bool(r["error"]) for r in rows),
        mean_interval(gap),
        float(gap.min()),
        mean_interval(distance),
        float(distance.min()),
        mean_interval(np.array([time_to_goal(r) for r in good])),
        {
            name: float(np.nanmean([r[name] for r in good]))
            for name in ("rms_acceleration", "rms_jerk", "rms_lateral")
        },
        (float(np.median(latency)), float(np.percentile(latency, 99))),
        sum(r["interventions"] for r in good),
        sum(r["failed_plans"] for r in good),
        sum(r["failed_fits"] for r in good),
        sum(r["oracle_failures"] for r in good),
    )


class Paired(NamedTuple):
    """Mean differences over the seeds that both egos finished."""

    seeds: int
    gap: Interval
    """Smallest gap between boxes, m."""
    time: Interval
    """To the goal, s."""
    collisions: int
    """More collisions."""


def paired(rows: Sequence[Row], scene: str, others: str, ego: str, other: str) -> Paired | None:
    """`ego` minus `other`, None where they have no seed in common."""
    one = {r["seed"]: r for r in good_rows(rows, scene, others, ego)}
    two = {r["seed"]: r for r in good_rows(rows, scene, others, other)}
    both = sorted(one.keys() & two.keys())
    if not both:
        return None
    return Paired(
        len(both),
        mean_interval(np.array([one[s]["min_gap"] - two[s]["min_gap"] for s in both])),
        mean_interval(np.array([time_to_goal(one[s]) - time_to_goal(two[s]) for s in both])),
        sum((one[s]["ended"] == COLLISION) - (two[s]["ended"] == COLLISION) for s in both),
    )
