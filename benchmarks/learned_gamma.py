"""Discount factors: the learned estimator and the inverse game, on the same episodes."""

from __future__ import annotations

import tempfile
import time
from typing import Any

import numpy as np

from agents import InferGamma
from agents.learned.gamma import learned_gamma
from agents.learned.gamma_network import WINDOW
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick
from evaluation.rollout.places import setting_of
from evaluation.training.generation import generate
from evaluation.training.supervised import observed_states
from foresight_env.envs.rendering.style import INTERVAL_DEVIATIONS

GUESS = "always the middle of the range"


def _inverse(row: TableRow) -> list[tuple[float, float, float]]:
    """Gamma of the other, its deviation, and seconds, by the estimator of `infer-gamma`."""
    env: Any = setting_of("crosswalk").make()
    env.reset(
        seed=0, options={"goals": np.array(row["goals"]).reshape(-1, 2), "gamma": row["gamma"]}
    )
    policy = InferGamma()
    memory = policy.init(env.scene, env.agents[0])
    observations = np.array(row["observations"]).reshape(row["steps"], -1)
    controls = np.array(row["controls"]).reshape(row["steps"], 2, 2)[:, 0]
    found = []
    for seen, control in zip(observations, controls, strict=True):
        begin = time.perf_counter()
        memory = policy.update(memory, seen, {})
        seconds = time.perf_counter() - begin
        early = memory.early
        memory = memory._replace(
            early=early._replace(perception=early.perception.acted(control.astype(np.float32)))
        )
        state = memory.state
        known = state is not None and state.estimate is not None
        found.append(
            (float(state.gamma[1]), float(state.gamma_deviation[1]), seconds)
            if known and state is not None
            else (np.nan, np.nan, seconds)
        )
    return found


def run(arguments: Arguments) -> list[Result]:
    """Episodes of the test split: 60, `quick` 6."""
    count = 6 if arguments.quick else 60
    yardstick = Yardstick.measure()
    with tempfile.TemporaryDirectory() as folder:
        rows = generate(folder, ("crosswalk",), count, "test")
    truth, groups = [], []
    said: dict[str, list[tuple[float, float, float]]] = {"inverse game": [], "learned": []}
    for k, row in enumerate(rows):
        states = observed_states(row)
        game = _inverse(row)
        for end in range(WINDOW, row["steps"] + 1, 2):
            window = states[end - WINDOW : end]
            learned_gamma(window)  # compiled before it is timed
            begin = time.perf_counter()
            mean, deviation = learned_gamma(window)
            seconds = time.perf_counter() - begin
            said["learned"].append((mean, deviation, seconds))
            said["inverse game"].append(game[end - 1])
            truth.append(row["gamma"][1])
            groups.append(k)
    true = np.array(truth)
    lines: list[TableRow] = []
    middle = np.full(len(true), 0.65)
    lines.append({"estimator": GUESS, "RMSE": f"{np.sqrt(np.mean((middle - true) ** 2)):.3f}",
                  "mean error": f"{np.mean(np.abs(middle - true)):.3f}", "90 % interval holds": "-",
                  "its half width": "-", "per window": "-"})  # fmt: skip
    for name, values in said.items():
        mean, deviation, seconds = np.array(values).T
        there = np.isfinite(mean)
        error = np.abs(mean - true)[there]
        half = INTERVAL_DEVIATIONS * deviation[there]
        lines.append(
            {
                "estimator": name,
                "RMSE": f"{np.sqrt(np.mean(error**2)):.3f}",
                "mean error": f"{error.mean():.3f}",
                "90 % interval holds": f"{np.mean(error <= half):.0%}",
                "its half width": f"{half.mean():.2f}",
                "per window": yardstick.formatted(float(np.median(seconds[there]))),
            }
        )
    note = (
        f"{len(rows)} crosswalks of the test split ({len(true)} windows of {WINDOW} observations, "
        "noise std 0.05, discount factors uniform in [0.3, 1]): the other pedestrian's discount "
        "factor, by the estimator of the ego `infer-gamma` and by `agents.learned.gamma`. "
        f"{yardstick.note}"
    )
    return [Result("Learned discount factors", note, lines).show(arguments.console)]
