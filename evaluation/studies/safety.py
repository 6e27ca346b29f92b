"""Safety of egos in the closed loop: settings, surprises and seeds; one row per episode.

Every ego meets every seed of every setting, among the agents that the ego's model expects and under
each surprise (`rollout.surprises`), with or without the safety filter. In the setting `RECORDED`
the others are those of a recording (`windows.replay`); there the n-th seed is the n-th episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents import make_ego
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.statistics import Interval, mean_interval
from evaluation.metrics.trajectory import at_fault
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, ending, harmed, time_to_goal
from evaluation.rollout.episode import WARM_UP_STEPS, Episode, episode, run_episode, warm_up
from evaluation.rollout.places import DEVELOPMENT_SEEDS, SETTINGS
from evaluation.rollout.setting import RunSetting
from evaluation.rollout.surprises import SURPRISES
from evaluation.windows.replay import ReplayEnv, replayed_episodes
from foresight_env.games.motion import planar_velocity

KEY = ("setting", "surprise", "ego", "settings", "seed")
RECORDED = "recorded"
"""Name of the setting whose other agents are recorded."""


def _base(setting: str) -> RunSetting:
    return RunSetting(RECORDED) if setting == RECORDED else SETTINGS[setting]


def setting_under(setting: str, surprise: str, safety_filter: bool = True) -> RunSetting:
    """The setting of that name under a surprise; `ValueError` where it cannot occur."""
    return replace(_base(setting), surprise=surprise, safety_filter=safety_filter)


def possible(setting: str, surprise: str) -> bool:
    """Whether a surprise can occur in a setting."""
    return _base(setting).scenario in SURPRISES[surprise].scenarios


def run_trial(
    setting: str,
    surprise: str,
    ego: str,
    settings: str,
    seed: int,
    safety_filter: bool,
    data: str | None,
) -> Row:
    """One episode's row; `settings` distinguishes egos of the same name in the store."""
    chosen = setting_under(setting, surprise, safety_filter)
    env = None
    if setting == RECORDED:
        env = _recorded(data, seed)
        for _ in islice(episode(env, chosen, ego, seed), WARM_UP_STEPS):
            pass
    else:
        warm_up(chosen, ego)
    found = run_episode(chosen, ego, seed, env)
    ended = ending(found.last)
    return {
        "ended": ended,
        "at_fault": ended == COLLISION and ego_at_fault(found),
        "time": float(found.last["time"]),
        "time_limit": found.time_limit,
        "min_gap": float(found.last["min_distance"]),
        "cost": found.cost,
        "steps": len(found.steps),
        **found.counts,
        "latencies": found.latencies,
    }


def _recorded(data: str | None, seed: int) -> Any:
    """The environment of a seed: development seeds are of the recordings for development."""
    development = seed in DEVELOPMENT_SEEDS
    number = seed - DEVELOPMENT_SEEDS[0] if development else seed
    found = replayed_episodes(data, "development" if development else "test")
    if number >= len(found):
        raise ValueError(f"seed: is {seed}; the recordings hold {len(found)} episodes")
    return ReplayEnv(found[number])


def ego_at_fault(found: Episode) -> bool:
    """Whether the ego caused the contact at an episode's end (`metrics.trajectory.at_fault`)."""
    scene, last = found.scene, found.states[-1]
    players = scene.game.players
    velocities = np.stack(
        [planar_velocity(p.dynamics, state) for p, state in zip(players, last, strict=True)]
    )
    driven = np.column_stack(
        [last[:, :2], np.hypot(*velocities.T), np.arctan2(velocities[:, 1], velocities[:, 0])]
    )
    return at_fault(driven, scene.controlled[0])


def study(
    folder: str | Path,
    settings: Sequence[str],
    surprises: Sequence[str],
    egos: Sequence[str],
    seeds: range,
    *,
    safety_filter: bool = True,
    data: str | Path | None = None,
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder`; surprises that cannot occur in a setting are left out.

    Episodes that the folder has already are not run again, unless `fresh`. `data`: recordings of
    the setting `RECORDED`, which has no more episodes than these hold; None: one that the project
    makes itself.
    """
    recordings = None if data is None else str(data)
    rule: dict[str, Any] = {"safety_filter": safety_filter, "data": recordings}
    store = Store(folder, "safety", rule, KEY, fresh=fresh)
    prints = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials: list[Trial] = [
        {
            "setting": setting,
            "surprise": surprise,
            "ego": ego,
            "settings": prints[ego],
            "seed": seed,
            **rule,
        }
        for setting in settings
        for surprise in surprises
        if possible(setting, surprise)
        for seed in _possible_seeds(setting, seeds, recordings)
        for ego in egos
    ]
    return run_trials(
        run_trial,
        trials,
        store,
        workers=workers,
        label="safety",
        programs=("setting", "surprise", "ego"),
    )


def _possible_seeds(setting: str, seeds: range, data: str | None) -> range:
    """Seeds of which there is an episode."""
    if setting != RECORDED:
        return seeds
    split = "development" if seeds[0] in DEVELOPMENT_SEEDS else "test"
    return seeds[: len(replayed_episodes(data, split))]


class SafetySummary(NamedTuple):
    """One ego in one setting under one surprise."""

    episodes: int
    collisions: int
    at_fault: int
    """Of these, that the ego caused."""
    off_road: int
    reached: int
    interventions: float
    """Part of the decisions whose action the safety filter replaced."""
    cost: Interval | None
    """Of the episodes without harm; None where there is none."""
    time: Interval
    """To the goal, s; the time limit where it was not reached."""
    latency_p99: float
    """Per decision, ms."""
    failed: int
    """Trials that raised an exception."""


def summarise(rows: Sequence[Row], setting: str, surprise: str, ego: str) -> SafetySummary | None:
    """Aggregate; None where no episode finished."""
    wanted = (setting, surprise, ego)
    mine = [r for r in rows if (r["setting"], r["surprise"], r["ego"]) == wanted]
    good = [r for r in mine if not r["error"]]
    if not good:
        return None
    costs = np.array([r["cost"] for r in good if not harmed(r)])
    return SafetySummary(
        len(good),
        sum(r["ended"] == COLLISION for r in good),
        sum(r["at_fault"] for r in good),
        sum(r["ended"] == OFF_ROAD for r in good),
        sum(r["ended"] == REACHED for r in good),
        sum(r["interventions"] for r in good) / sum(r["steps"] for r in good),
        mean_interval(costs) if len(costs) else None,
        mean_interval(np.array([time_to_goal(r) for r in good])),
        float(np.percentile(np.concatenate([r["latencies"] for r in good]), 99)),
        len(mine) - len(good),
    )
