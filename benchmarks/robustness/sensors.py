"""Estimators, predictors and egos whose sensors are broken."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agents import History, InferGamma, make_predictor
from benchmarks.robustness.tally import Random, Tally
from foresight_env.envs import crosswalk_v0
from foresight_env.games import full_state, positions
from foresight_env.inverse import Free, MovingHorizonEstimator
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting, player_theta

WINDOW = 5
HORIZON = 10
EPISODE = 12

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
    "an agent is never observed": lambda random, rows: _without(rows, 0),
    "no agent is observed": lambda random, rows: np.full_like(rows, np.nan),
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
    for start, goal in zip(setting.initial_state[:, :2], setting.goals, strict=True):
        place = start + part * (goal - start) + 0.03 * random.normal(size=(steps, 2))
        pace = np.tile((goal - start) / (0.1 * steps), (steps, 1)).clip(-0.8, 0.8)
        rows.append(np.concatenate([place, pace], axis=1) if full else place)
    return np.concatenate(rows, axis=1)


def use_estimator(random: Random, tally: Tally) -> None:
    """A stream of observations with a fault, through the online estimator."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    full = bool(random.random() < 0.5)
    name = f"estimator: {fault}"
    game = crosswalk_game(2, horizon=HORIZON)
    model = (full_state if full else positions)(game.state_sizes)
    estimator = MovingHorizonEstimator(
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
            tally.must_be_finite(
                name,
                "deviation, reduced_chi_squared",
                state.gamma_deviation,
                state.reduced_chi_squared,
            )
    tally.done[name] += 1


PREDICTORS = (
    "constant-velocity", "constant-turn-rate", "kalman", "social-force", "orca", "idm",
    "social-lstm", "transformer",
)  # fmt: skip
"""Those that are quick."""
SHOWN = 8
"""Steps that a predictor is shown."""


def use_predictor(random: Random, tally: Tally) -> None:
    """A history with a fault, for every quick predictor; every agent is observed once at least."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    rows = FAULTS[fault](random, _walks(random, SHOWN, True)).reshape(SHOWN, 2, 4)
    missing = np.isnan(rows).any(axis=2)
    rows[missing] = np.nan
    rows[0, missing.all(axis=0)] = 0.0
    headings = np.where(np.isnan(rows[..., 2]), np.nan, np.arctan2(rows[..., 3], rows[..., 2]))
    history = History(rows, headings, ("pedestrian", "pedestrian"), np.full((2, 2), 0.5), 0.4)
    for predictor in PREDICTORS:
        name = f"predictors: {predictor}"
        forecast = make_predictor(predictor).predict(history, 6)
        tally.must_be_finite(name, fault, forecast.positions, forecast.probabilities)
        tally.done[name] += 1


def use_ego(random: Random, tally: Tally) -> None:
    """A crossing of the ego that infers, whose sensors have a fault."""
    fault = list(FAULTS)[random.integers(len(FAULTS))]
    name = f"ego: {fault}"
    env = crosswalk_v0.parallel_env(planning_horizon=HORIZON, max_steps=EPISODE)
    observations, infos = env.reset(seed=int(random.integers(2**31)))
    (agent,) = env.agents
    policy = InferGamma(window=WINDOW, ahead=HORIZON - WINDOW + 1)
    memory = policy.init(env.scene, agent)
    rows = [observations[agent]]
    while env.agents:
        seen = rows[-1].astype(float)
        with np.errstate(over="ignore"):
            # Faults are of whole tracks, so the rest of this one is made up; the goal is known.
            track = np.stack([*rows, *[rows[-1]] * (EPISODE - len(rows))])[:, :8].astype(float)
            seen[4:8] = FAULTS[fault](random, track)[len(rows) - 1][4:8]
        memory = policy.update(memory, seen, infos[agent])
        decision, memory = policy.act(memory)
        if not env.action_space(agent).contains(decision.action):
            tally.violations.append(f"{name}: action outside its space: {decision.action}")
        tally.failed[name] += int(decision.plan_fallback) + int(decision.estimate_outdated)
        observations, _, _, _, infos = env.step({agent: decision.action})
        rows.append(observations[agent])
    env.close()
    tally.done[name] += 1
    tally.episodes["foresight/crosswalk-v0, parallel"] += 1
