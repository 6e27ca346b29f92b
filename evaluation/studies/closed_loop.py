"""Egos in the loop: paired seeds, one row per episode.

The ego is player 0 of a crosswalk with a known discount factor of its own; the others play the
equilibrium of the true game at every step, with discount factors that nobody is told.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents import Decision, make_ego
from evaluation.execution.compilation import until_forgotten
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store
from evaluation.metrics.statistics import Interval, mean_interval
from foresight_env.envs.crosswalk_v0 import parallel_env

EGO_GAMMA = 0.95
"""The ego's own discount factor: a robot that looks ahead."""
OTHERS_GAMMA = (0.3, 1.0)
MAX_STEPS = 100
KEY = ("ego", "settings", "seed")
SCHEMA = 6
"""Counted up when rows get other columns, mean something else or come from another way of solving
or planning: older folders are refused."""
KNOWING = ("oracle", "farsighted")
"""Egos that know or assume the discount factors in their decisions; others infer them."""


class Step(NamedTuple):
    """What happened at one step of an episode."""

    state: Float[np.ndarray, "N 4"]
    observation: Float[np.ndarray, "size"]
    decision: Decision
    latency: float
    """Seconds for update and decision."""
    info: dict[str, Any]
    """As the environment returned it after the step."""


def inferred(ego: str, decision: Decision) -> dict[int, tuple[float, float]]:
    """Means and deviations of the discount factors that an ego's decision inferred."""
    return {} if ego in KNOWING else dict(decision.gammas)


@dataclass(frozen=True)
class ClosedLoop:
    """Configuration of the closed-loop study."""

    players: int = 2
    observation: str = "full"
    noise_std: float = 0.05
    behaviour: str = "receding"


def make_environment(setting: ClosedLoop, render_mode: str | None = None) -> Any:
    """The crosswalk with player 0 to be controlled."""
    return parallel_env(
        players=setting.players,
        controlled=(0,),
        behaviour=setting.behaviour,  # type: ignore[arg-type]
        observation=setting.observation,  # type: ignore[arg-type]
        noise_std=setting.noise_std,
        max_steps=MAX_STEPS,
        render_mode=render_mode,  # type: ignore[arg-type]
    )


def episode(
    env: Any, ego: str, seed: int, gammas: tuple[float, float] = OTHERS_GAMMA
) -> Iterator[Step]:
    """Run one episode of `env` with a registered ego, step by step; the others' gammas are drawn.

    The ego is the one agent that `env` leaves to be controlled.
    """
    policy = make_ego(ego)
    players = env.scene.players
    hidden = np.random.default_rng([seed, 1]).uniform(*gammas, players)
    hidden[env.scene.controlled[0]] = EGO_GAMMA
    observations, infos = env.reset(seed=seed, options={"gamma": hidden})
    agent = env.agents[0]
    memory = policy.init(env.scene, agent)
    while env.agents:
        state = infos[agent]["state"]
        begin = time.perf_counter()
        memory = policy.update(memory, observations[agent], infos[agent])
        decision, memory = policy.act(memory)
        latency = time.perf_counter() - begin
        seen = observations[agent]
        observations, rewards, _, _, infos = env.step({agent: decision.action})
        yield Step(
            state, seen, decision, latency, {**infos[agent], "reward": float(rewards[agent])}
        )


WARM_UP_STEPS = 13
"""Steps after which every program that an ego needs has been compiled: the window slides."""


@until_forgotten
def warm_up(ego: str, setting: ClosedLoop) -> None:
    """Compile in this process what an episode needs, so that latencies are those of running."""
    env = make_environment(setting)
    for _ in islice(episode(env, ego, 0), WARM_UP_STEPS):
        pass


def run_episode(ego: str, settings: str, seed: int, **setting: Any) -> Row:
    """One episode's row; `settings` tells egos of the same name apart in the store."""
    warm_up(ego, ClosedLoop(**setting))
    env = make_environment(ClosedLoop(**setting))
    steps = list(episode(env, ego, seed))
    last = steps[-1].info
    latencies = 1e3 * np.array([s.latency for s in steps])
    true = last["gamma"]
    errors = [
        abs(mean - true[j]) for j, (mean, _) in steps[-1].decision.gammas.items() if ego != "oracle"
    ]
    return {
        "collision": bool(last["collision"]),
        "goal_reached": bool(last["goal_reached"]) and not last["collision"],
        "time_out": not last["collision"] and not last["goal_reached"],
        "time": float(last["time"]),
        "min_distance": float(last["min_distance"]),
        "cost": -sum(s.info["reward"] for s in steps) * env.scene.dt,
        "failed_plans": sum(s.decision.failed for s in steps),
        "failed_fits": sum(s.decision.stale for s in steps),
        "oracle_failures": int(last["solver_failures"]),
        "gamma_error": float(np.mean(errors)) if errors else None,
        "latencies": latencies.tolist(),
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
    configuration = {**setting.__dict__, "schema": SCHEMA}
    store = Store(folder, "closed loop", configuration, KEY, fresh=fresh)
    settings = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials = [
        {"ego": ego, "settings": settings[ego], "seed": seed, **setting.__dict__}
        for seed in seeds
        for ego in egos
    ]
    return run_trials(run_episode, trials, store, workers=workers, label="closed loop")


class Summary(NamedTuple):
    """One ego's line of the table."""

    ego: str
    episodes: int
    collisions: int
    reached: int
    time_outs: int
    errors: int
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
    """Milliseconds per decision, compilation apart."""
    latency_p99: float
    failed_plans: int
    """Decisions without a solved plan: the one before was continued, or the ego braked."""
    failed_fits: int
    """Decisions with an older estimate, because the latest fit failed."""


def summarise(rows: list[Row], ego: str, dt: float = 0.1) -> Summary:
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
    return Summary(
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
