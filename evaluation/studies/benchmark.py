"""The benchmark's trials: every predictor on every window, every ego in every episode."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents import make_ego, make_predictor
from agents.registry import REACTIVE_EGOS
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.prediction import judged
from evaluation.rollout.episode import Episode, run_episode, warm_up
from evaluation.rollout.places import is_driving, setting_of
from evaluation.windows.simulated import BETWEEN, PREDICTED_STEPS, simulated_windows

OPEN_KEY = ("place", "seed", "predictor", "settings")
CLOSED_KEY = ("place", "others", "ego", "settings", "seed")
PREDICTED_SECONDS = 1.0
"""How far ahead an ego's own predictions are judged."""
PER_WINDOW = (
    "average_error", "final_error", "missed", "best_average_error", "nll", "levels",
    "overlaps", "overlaps_recorded",
)  # fmt: skip
"""Metrics of a prediction."""
OPEN_SEEDS = 1_000_000
"""Episodes that predictors are tested on begin with this seed: egos' episodes, and the data that
models are trained on, have others."""


@dataclass(frozen=True)
class BenchmarkConfiguration:
    """Configuration of the benchmark."""

    places: tuple[str, ...]
    others: tuple[str, ...]
    """Behaviours of the other cars of driving; elsewhere it is always the game."""
    predictors: tuple[str, ...]
    egos: tuple[str, ...]
    episodes: int

    def pairs(self) -> list[tuple[str, str]]:
        """Places with what drives the others there."""
        return [
            (place, others)
            for place in self.places
            for others in (self.others if is_driving(place) else ("receding",))
        ]

    def egos_of(self, place: str) -> tuple[str, ...]:
        """Those that can be there: highway-env's vehicle needs its roads, networks a crosswalk."""
        roads: tuple[str, ...] = () if is_driving(place) else ("idm",)
        elsewhere = roads if place == "crosswalk" else (*roads, *REACTIVE_EGOS)
        return tuple(ego for ego in self.egos if ego not in elsewhere)


def run_windows(place: str, seed: int, predictor: str, settings: str) -> Row:
    """A predictor's metrics on the windows of one episode, a list entry for each; it may be short
    of any."""
    made, rows, seconds = make_predictor(predictor), [], []
    windows = simulated_windows(place, seed)
    for window in windows:
        history = window.history
        made.predict(history, PREDICTED_STEPS)  # latencies are those of running, not of compiling
        begin = time.perf_counter()
        forecast = made.predict(history, PREDICTED_STEPS)
        seconds.append(time.perf_counter() - begin)
        rows.append(judged(history, window.truth, forecast))
    return {
        **{name: [row[name] for row in rows] for name in (*PER_WINDOW, "fallback")},
        "seconds": seconds,
        "agents": [len(window.agents) for window in windows],
    }


def run_trial(place: str, others: str, ego: str, settings: str, seed: int) -> Row:
    """One episode's row."""
    setting = setting_of(place, others)
    warm_up(setting, ego)
    found = run_episode(setting, ego, seed)
    last = found.last
    collided, strayed = bool(last["collision"]), bool(last["off_road"])
    return {
        "collision": collided,
        "off_road": strayed and not collided,
        "goal_reached": bool(last["is_success"]),
        "time": float(last["time"]),
        "time_limit": found.time_limit,
        "min_gap": float(last["min_distance"]),
        "cost": found.cost,
        "prediction_error": _prediction_error(found),
        **found.counts,
        "latencies": found.latencies,
    }


def _prediction_error(found: Episode) -> float | None:
    """Mean error (m) of the ego's predictions of others, `PREDICTED_SECONDS` ahead."""
    ahead = round(PREDICTED_SECONDS / found.dt)
    places = found.states[..., :2]
    errors = [
        float(np.linalg.norm(path[ahead - 1] - places[k + ahead, j]))
        for k, step in enumerate(found.steps)
        for j, path in step.decision.predicted.items()
        if k + ahead < len(places) and len(path) >= ahead
    ]
    return float(np.mean(errors)) if errors else None


def open_study(
    folder: Path, configuration: BenchmarkConfiguration, *, workers: Workers = None
) -> list[Row]:
    """Predictors on simulated episodes; a row per episode and predictor, kept in `folder`."""
    settings = {name: fingerprint(make_predictor(name)) for name in configuration.predictors}
    rule = {"between": BETWEEN, "predicted": PREDICTED_STEPS}
    store = Store(folder, "benchmark, open loop", rule, OPEN_KEY)
    trials: list[Trial] = [
        {"place": place, "seed": OPEN_SEEDS + k, "predictor": name, "settings": settings[name]}
        for place in configuration.places
        for k in range(configuration.episodes)
        for name in configuration.predictors
    ]
    return run_trials(
        run_windows,
        trials,
        store,
        workers=workers,
        label="open loop",
        programs=("place", "predictor"),
    )


def closed_study(
    folder: Path, configuration: BenchmarkConfiguration, *, workers: Workers = None
) -> list[Row]:
    """Egos in episodes with the same seeds; a row per episode and ego, kept in `folder`."""
    settings = {name: fingerprint(make_ego(name)) for name in configuration.egos}
    store = Store(folder, "benchmark, closed loop", {}, CLOSED_KEY)
    trials: list[Trial] = [
        {"place": place, "others": others, "ego": ego, "settings": settings[ego], "seed": seed}
        for place, others in configuration.pairs()
        for ego in configuration.egos_of(place)
        for seed in range(configuration.episodes)
    ]
    return run_trials(
        run_trial,
        trials,
        store,
        workers=workers,
        label="closed loop",
        programs=("place", "others", "ego"),
    )
