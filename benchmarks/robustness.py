"""Rough use: extreme and malformed actions, options and configurations; broken sensors.

Whatever is wrong must be refused by a `ValueError` before anything changes, whatever fails must be
a status, nothing may be NaN, and memory must stay flat. What breaks one of these is a *violation*;
there should be none. The full study takes an hour.
"""

from __future__ import annotations

import gc
import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import foresight_env.envs  # noqa: F401  (registers the environments)
from agents import Foresight, History, make_predictor
from benchmarks.report import Result, Row, Setting
from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0
from foresight_env.equilibrium import Status
from foresight_env.games import full_state, positions
from foresight_env.inverse import Free, OnlineEstimator
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting, player_theta

MINUTES = 60.0
QUICK_MINUTES = 2.0
LEAST_USES = 10_000
"""Uses (episodes, streams of observations, forecasts) that the full study makes at least."""
MEBIBYTE = 2**20
WINDOW = 5
HORIZON = 10

Random = np.random.Generator
Use = Callable[[Random, "Tally"], None]


@dataclass
class Tally:
    """What happened, by the name of what was used."""

    done: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    failed: Counter[str] = field(default_factory=Counter)
    """Failures that a status told."""
    violations: list[str] = field(default_factory=list)

    def must_refuse(self, name: str, told: str, call: Callable[[], Any]) -> None:
        """Call what is wrong: only `ValueError` is right."""
        try:
            call()
        except ValueError:
            self.refused[name] += 1
        except Exception as error:
            self.violations.append(f"{name}: {told}: {type(error).__name__}: {error}")
        else:
            self.violations.append(f"{name}: {told} was accepted")

    def must_be_finite(self, name: str, told: str, *values: Any) -> None:
        """Nothing in these arrays may be NaN or infinite."""
        for value in values:
            if not np.isfinite(np.asarray(value, float)).all():
                self.violations.append(f"{name}: {told}: {value}")


PARALLEL: dict[str, Callable[..., Any]] = {
    "crosswalk, receding": partial(
        crosswalk_v0.parallel_env, planning_horizon=6, max_steps=12, noise_std=0.1
    ),
    "crosswalk, three open loop": partial(
        crosswalk_v0.parallel_env,
        players=3,
        behaviour="open_loop",
        observation="positions",
        max_steps=12,
        planning_horizon=6,
    ),
    "crosswalk, all controlled": partial(crosswalk_v0.parallel_env, players=6, controlled="all"),
    "intersection": partial(
        intersection_v0.parallel_env, pedestrians=1, cars=1, planning_horizon=6, max_steps=8
    ),
    "left turn": partial(driving_v0.parallel_env, cars=2, planning_horizon=4, max_steps=8),
    "merge, IDM": partial(
        driving_v0.parallel_env, scene="merge", cars=3, behaviour="idm", max_steps=20
    ),
    "roundabout, all controlled": partial(
        driving_v0.parallel_env, scene="roundabout", cars=4, controlled="all", max_steps=30
    ),
}
"""Environments that are used; few games are compiled."""

SINGLE: dict[str, dict[str, Any]] = {
    "foresight/Crosswalk-v0": {"planning_horizon": 6, "max_steps": 12},
    "foresight/Intersection-v0": {
        "pedestrians": 1, "cars": 1, "planning_horizon": 6, "max_steps": 8
    },
    "foresight/Driving-v0": {"cars": 2, "planning_horizon": 4, "max_steps": 8},
}  # fmt: skip
"""Gymnasium ids with arguments; they share the games of the above."""

WRONG_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "planning_horizon": (0, -1, 2.5, "long", None),
    "max_steps": (0, -3, np.nan, "many"),
    "noise_std": (-0.1, np.nan, np.inf, "much"),
    "observation": ("everything", None, 3),
    "behaviour": ("asleep", 7),
    "controlled": ((99,), (0, 0), "some", (-1,), (0.5,)),
    "render_mode": ("ascii", 1),
    "ranges": ((0.3, 1.0), "wide"),
}

ACTIONS: dict[str, Callable[[Random, Any], np.ndarray]] = {
    "highest": lambda random, space: space.high,
    "lowest": lambda random, space: space.low,
    "corner": lambda random, space: np.where(random.random(2) < 0.5, space.low, space.high),
    "nothing": lambda random, space: np.zeros_like(space.low),
    "anything": lambda random, space: random.uniform(space.low, space.high).astype(np.float32),
    "tiny": lambda random, space: np.full_like(space.low, np.finfo(np.float32).tiny),
    "in double precision": lambda random, space: random.uniform(space.low, space.high),
}

SPOILED: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no dictionary": lambda actions: list(actions.values()),
    "none": lambda actions: None,
    "no agents": lambda actions: {},
    "a stranger": lambda actions: {**actions, "stranger": np.zeros(2)},
    "not a number": lambda actions: {a: np.array([np.nan, 0.0]) for a in actions},
    "infinite": lambda actions: {a: np.array([np.inf, 0.0]) for a in actions},
    "out of range": lambda actions: {a: np.array([1e3, 0.0]) for a in actions},
    "wrong shape": lambda actions: {a: np.zeros((2, 2)) for a in actions},
    "ragged": lambda actions: {a: [[1.0], [1.0, 2.0]] for a in actions},
    "text": lambda actions: {a: "left" for a in actions},
    "complex": lambda actions: {a: np.array([1j, 0.0]) for a in actions},
}


def _options(random: Random, players: int, states: np.ndarray) -> dict[str, Any]:
    """Options on and beyond the edge of what makes sense; some must be refused, others may be."""
    shape = np.shape(states)
    cases: list[dict[str, Any]] = [
        {},
        {"gamma": random.uniform(0.0, 1.0, players)},
        {"gamma": np.zeros(players)},
        {"gamma": np.full(players, 1.2)},
        {"initial_states": states + random.normal(0.0, 0.1, shape)},
        {"initial_states": np.tile(states[:1], (players, 1))},  # all in one place
        {"initial_states": 1e6 * np.ones(shape)},
    ]
    return cases[random.integers(len(cases))]


WRONG_OPTIONS: tuple[Any, ...] = (
    {"gamma": [np.nan]},
    {"gamma": "patient"},
    {"gamma": -np.ones(2)},
    {"goals": [[np.inf, 0.0]]},
    {"initial_states": np.zeros(3)},
    {"unknown": 1},
    "options",
    {"situation": {"gamma": 1.0}},
)


def use_parallel(name: str, make: Callable[..., Any], random: Random, tally: Tally) -> None:
    """One episode of a parallel environment, with wrong calls in between."""
    if random.random() < 0.1:
        argument = list(WRONG_ARGUMENTS)[random.integers(len(WRONG_ARGUMENTS))]
        values = WRONG_ARGUMENTS[argument]
        wrong = {argument: values[random.integers(len(values))]}
        tally.must_refuse(name, f"argument {wrong}", lambda: make(**wrong))
    env = make()
    seed = int(random.integers(2**31))
    if random.random() < 0.3:
        spoiled = WRONG_OPTIONS[random.integers(len(WRONG_OPTIONS))]
        told = f"options {spoiled!r}"
        tally.must_refuse(name, told, lambda: env.reset(seed=seed, options=spoiled))
    env.reset(seed=seed)
    scene = env.scene
    first = np.asarray(env.reset(seed=seed)[1][env.agents[0]]["state"])
    try:
        options = _options(random, scene.players, first)
        observations, infos = env.reset(seed=seed, options=options)
    except ValueError:
        tally.refused[name] += 1
        observations, infos = env.reset(seed=seed)
    _judge(name, env, observations, {}, infos, tally)
    kinds = list(ACTIONS.values())
    usual = kinds[random.integers(len(kinds))]
    while env.agents:
        chosen = usual if random.random() < 0.7 else kinds[random.integers(len(kinds))]
        actions = {a: chosen(random, env.action_space(a)) for a in env.agents}
        if random.random() < 0.15:
            told, spoil = list(SPOILED.items())[random.integers(len(SPOILED))]
            wrong_actions = spoil(actions)
            tally.must_refuse(name, f"actions, {told}", lambda: env.step(wrong_actions))  # noqa: B023
        observations, rewards, _, _, infos = env.step(actions)
        _judge(name, env, observations, rewards, infos, tally)
    env.close()
    tally.done[name] += 1


def _judge(name: str, env: Any, observations: Any, rewards: Any, infos: Any, tally: Tally) -> None:
    for agent, seen in observations.items():
        if not env.observation_space(agent).contains(seen):
            tally.violations.append(f"{name}: observation outside its space: {seen}")
    tally.must_be_finite(name, "rewards", *rewards.values())
    for info in infos.values():
        told = [info[key] for key in ("state", "gamma", "controls", "min_distance", "time")]
        tally.must_be_finite(name, "information", *told)
        status = int(info["solver_status"])
        if status not in (-1, *map(int, Status)):
            tally.violations.append(f"{name}: unknown status {status}")
        tally.failed[name] += status not in (-1, Status.SOLVED)


def use_single(name: str, random: Random, tally: Tally) -> None:
    """One episode of a Gymnasium id with random actions."""
    env = gymnasium.make(name, **SINGLE[name])
    seen, _ = env.reset(seed=int(random.integers(2**31)))
    kinds, done = list(ACTIONS.values()), False
    while not done:
        seen, reward, terminated, truncated, _ = env.step(
            np.asarray(kinds[random.integers(len(kinds))](random, env.action_space), np.float32)
        )
        tally.must_be_finite(name, "observation, reward", seen, reward)
        done = terminated or truncated
    env.close()
    tally.done[name] += 1


FAULTS: dict[str, Callable[[Random, np.ndarray], np.ndarray]] = {
    "nothing wrong": lambda random, rows: rows,
    "outliers": lambda random, rows: (
        rows + np.where(random.random(rows.shape) < 0.1, random.normal(0.0, 20.0, rows.shape), 0.0)
    ),
    "huge outliers": lambda random, rows: np.where(random.random(rows.shape) < 0.05, 1e8, rows),
    "frozen sensor": lambda random, rows: np.concatenate(
        [rows[: len(rows) // 3], np.tile(rows[len(rows) // 3], (len(rows) - len(rows) // 3, 1))]
    ),
    "an agent vanishes": lambda random, rows: _without(rows, len(rows) // 2),
    "an agent is never seen": lambda random, rows: _without(rows, 0),
    "nobody is seen": lambda random, rows: np.full_like(rows, np.nan),
    "teleport": lambda random, rows: (
        rows + np.where(np.arange(len(rows)) > len(rows) // 2, 10.0, 0.0)[:, None]
    ),
    "standing still": lambda random, rows: np.tile(rows[0], (len(rows), 1)),
    "all in one place": lambda random, rows: np.zeros_like(rows),
    "gaps": lambda random, rows: np.where(random.random(rows.shape) < 0.5, np.nan, rows),
}


def _without(rows: np.ndarray, since: int) -> np.ndarray:
    """The second agent is gone from row `since` on."""
    found = rows.copy()
    found[since:, rows.shape[1] // 2 :] = np.nan
    return found


def _walks(random: Random, steps: int, full: bool) -> np.ndarray:
    """Two people who walk to their goals at an even pace, observed with noise."""
    setting = nominal_setting(2)
    part = np.linspace(0.0, 1.0, steps)[:, None]
    rows = []
    for start, goal in zip(setting.initial_states[:, :2], setting.goals, strict=True):
        place = start + part * (goal - start) + 0.03 * random.normal(size=(steps, 2))
        pace = np.tile((goal - start) / (0.1 * steps), (steps, 1)).clip(-0.8, 0.8)
        rows.append(np.concatenate([place, pace], axis=1) if full else place)
    return np.concatenate(rows, axis=1)


def use_estimator(random: Random, tally: Tally) -> None:
    """A stream of observations with a fault, through the online estimator."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    full = bool(random.random() < 0.5)
    name = f"estimator, {fault}"
    game = crosswalk_game(2, horizon=HORIZON)
    model = (full_state if full else positions)(game.state_sizes)
    estimator = OnlineEstimator(
        game, model, Free(("goal",), initial_state=True), 0.03**2, window=WINDOW
    )
    theta = [player_theta(goal) for goal in nominal_setting(2).goals]
    state = estimator.init(theta, 0.8)
    with np.errstate(over="ignore"):
        rows = FAULTS[fault](random, _walks(random, 15, full))
    for row in rows:
        if random.random() < 0.05:
            wrong = random.choice(["infinite", "too short"])
            spoiled = np.full(model.size, np.inf) if wrong == "infinite" else row[:-1]
            kept = state
            tally.must_refuse(name, wrong, lambda: estimator.update(kept, spoiled))  # noqa: B023
        before = state.failures
        state = estimator.update(state, row)
        tally.failed[name] += state.failures - before
        tally.must_be_finite(name, "discount factors", state.gamma)
        if state.estimate is not None:
            tally.must_be_finite(name, "present", *(state.present or ()))
            tally.must_be_finite(name, "plan", *state.estimate.solution.states)
            tally.must_be_finite(name, "deviation, misfit", state.gamma_deviation, state.misfit)
    tally.done[name] += 1


PREDICTORS = (
    "constant-velocity", "constant-turn-rate", "kalman", "social-force", "orca", "idm",
    "social-lstm", "transformer",
)  # fmt: skip
"""Those that are quick."""
SHOWN = 8
"""Steps that a predictor is shown."""


def use_predictor(random: Random, tally: Tally) -> None:
    """A history with a fault, for every quick predictor; everybody is seen once at least."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    rows = FAULTS[fault](random, _walks(random, SHOWN, True)).reshape(SHOWN, 2, 4)
    missing = np.isnan(rows).any(axis=2)
    rows[missing] = np.nan
    rows[0, missing.all(axis=0)] = 0.0
    headings = np.where(np.isnan(rows[..., 2]), np.nan, np.arctan2(rows[..., 3], rows[..., 2]))
    history = History(rows, headings, ("pedestrian", "pedestrian"), np.full((2, 2), 0.5), 0.4)
    for predictor in PREDICTORS:
        name = f"predictor, {predictor}"
        forecast = make_predictor(predictor).predict(history, 6)
        tally.must_be_finite(name, fault, forecast.positions, forecast.probabilities)
        tally.done[name] += 1


def use_ego(random: Random, tally: Tally) -> None:
    """A crossing of the ego that infers, whose sensors have a fault."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    name = f"ego, {fault}"
    env = crosswalk_v0.parallel_env(planning_horizon=HORIZON, max_steps=12)
    observations, infos = env.reset(seed=int(random.integers(2**31)))
    (agent,) = env.agents
    policy = Foresight(window=WINDOW, ahead=HORIZON - WINDOW + 1)
    memory = policy.init(env.scene, agent)
    rows = [observations[agent]]
    while env.agents:
        seen = rows[-1].astype(float)
        with np.errstate(over="ignore"):
            # Faults are of whole tracks; the goal is known.
            seen[4:8] = FAULTS[fault](random, np.stack(rows)[:, :8].astype(float))[-1][4:8]
        memory = policy.update(memory, seen, infos[agent])
        decision, memory = policy.act(memory)
        if not env.action_space(agent).contains(decision.action):
            tally.violations.append(f"{name}: action outside its space: {decision.action}")
        tally.failed[name] += int(decision.failed) + int(decision.stale)
        observations, _, _, _, infos = env.step({agent: decision.action})
        rows.append(observations[agent])
    env.close()
    tally.done[name] += 1


def uses() -> dict[str, tuple[Use, float]]:
    """By kind: what is done, and its weight when one is drawn."""
    found: dict[str, tuple[Use, float]] = {
        name: (partial(use_parallel, name, make), 1.0) for name, make in PARALLEL.items()
    }
    found |= {name: (partial(use_single, name), 1.0) for name in SINGLE}
    found |= {
        "estimator": (use_estimator, 2.0),
        "predictors": (use_predictor, 1.0),
        "ego": (use_ego, 0.5),
    }
    return found


def rough_use(seconds: float, least: int, seed: int = 0) -> tuple[Tally, list[float]]:
    """Use everything once, then at random for `seconds` and until `least` uses are done.

    Also returns the memory of this process (MiB) after each tenth of the time, the first of them
    when everything had been used once.
    """
    random, tally, every = np.random.default_rng(seed), Tally(), uses()
    weights = np.array([weight for _, weight in every.values()])

    def once(kind: str) -> None:
        try:
            every[kind][0](random, tally)
        except Exception as error:
            tally.violations.append(f"{kind}: {type(error).__name__}: {error}")

    for kind in every:
        once(kind)
    begin, memory = time.monotonic(), [resident_memory()]
    while (passed := time.monotonic() - begin) < seconds or tally.done.total() < least:
        once(str(random.choice(list(every), p=weights / weights.sum())))
        if passed > len(memory) * seconds / 10.0 > 0.0:
            memory.append(resident_memory())
    return tally, [*memory, resident_memory()]


def resident_memory() -> float:
    """Of this process, MiB; NaN where the system does not tell."""
    gc.collect()
    told = Path("/proc/self/statm")
    if not told.exists():
        return float("nan")
    return int(told.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MEBIBYTE


def run(setting: Setting) -> list[Result]:
    """The study; `quick` takes two minutes."""
    minutes, least = (QUICK_MINUTES, 0) if setting.quick else (MINUTES, LEAST_USES)
    begin = time.monotonic()
    tally, memory = rough_use(60.0 * minutes, least)
    passed = (time.monotonic() - begin) / 60.0
    rows: list[Row] = [
        {
            "used": name,
            "times": tally.done[name],
            "wrong calls refused": tally.refused[name],
            "failures told by a status": tally.failed[name],
            "violations": sum(v.startswith(name) for v in tally.violations),
        }
        for name in sorted(set(tally.done) | set(tally.refused))
    ]
    told = ", ".join(f"{value:.0f}" for value in memory)
    first = "; ".join(dict.fromkeys(tally.violations[:5])) or "none"
    note = (
        f"{tally.done.total()} uses in {passed:.0f} minutes, drawn at random; resident memory at "
        f"each tenth of them (MiB): {told}. Violations: {len(tally.violations)} ({first})."
    )
    return [Result("Rough use", note, rows).show(setting.console)]
