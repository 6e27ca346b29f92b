"""Data sets of simulated episodes: observations, true futures and true parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from evaluation.execution.local import Workers
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, StoreError, Trial, read_results
from evaluation.rollout.episode import run_episode
from evaluation.rollout.places import setting_of
from evaluation.studies.benchmark import OPEN_SEEDS
from evaluation.training.names import SPLITS

KEY = ("place", "seed")
COLUMNS = (
    *KEY, "dt", "players", "steps", "ego", "gamma", "goals", "states", "controls", "observations",
    "collision", "goal_reached", "failures", "error",
)  # fmt: skip
"""Of an episode."""
FIRST_SEED = {split: (2 + k) * OPEN_SEEDS for k, split in enumerate(SPLITS)}
"""Of each split; studies of egos begin with 0, the benchmark's open loop with `OPEN_SEEDS`."""
MOST = OPEN_SEEDS
"""Episodes of a split: beyond, seeds would be those of the next."""


def run_trial(place: str, seed: int) -> Row:
    """One episode in which all agents play the game, the ego (the oracle) as well.

    `states` (T+1, N, 4), `controls` (T, N, 2) and `observations` (T, size) are flattened.
    """
    setting = replace(setting_of(place), safety_filter=False)
    found = run_episode(setting, "oracle", seed)
    last, steps, states = found.last, found.steps, found.states
    return {
        "dt": found.dt,
        "players": states.shape[1],
        "steps": len(steps),
        "ego": found.scene.controlled[0],
        "gamma": last["gamma"].tolist(),
        "goals": last["theta"]["goal"].ravel().tolist(),
        "states": states.ravel().tolist(),
        "controls": np.stack([s.info["controls"] for s in steps]).ravel().tolist(),
        "observations": np.stack([s.observation for s in steps]).ravel().tolist(),
        "collision": bool(last["collision"]),
        "goal_reached": bool(last["is_success"]),
        "failures": int(last["solver_failures"]),
    }


def generate(
    folder: str | Path, places: Sequence[str], episodes: int, split: str, workers: Workers = None
) -> list[Row]:
    """So many episodes of every place in `folder`; those that it has already are kept."""
    if split not in SPLITS:
        raise ValueError(f"split: is {split!r}; expected one of {', '.join(SPLITS)}")
    if not 1 <= episodes <= MOST:
        raise ValueError(f"episodes: is {episodes}; expected 1 to {MOST}")
    store = Store(folder, f"episodes, {split}", {}, KEY)
    trials: list[Trial] = [
        {"place": place, "seed": FIRST_SEED[split] + k} for place in places for k in range(episodes)
    ]
    return run_trials(
        run_trial, trials, store, workers=workers, label=split, chunk=16, programs=("place",)
    )


def episodes_in(folder: str | Path, split: str) -> list[Row]:
    """Return the episodes of a split that a folder holds, without failed ones, in order of keys.

    A data set is used whatever code made it; only extending it (`generate`) needs the same code.

    Raises:
        ValueError: the folder has no episodes, holds something else, or lacks a column.
    """
    path = Path(folder)
    if not (path / "manifest.json").is_file():
        raise ValueError(f"{path}: holds no episodes; make them with foresight generate")
    held = read_results(path)
    if held.study != f"episodes, {split}":
        raise StoreError(f"{path}: holds results of another study ({held.study})")
    lacking = [name for name in COLUMNS if held.rows and name not in held.rows[0]]
    if lacking:
        raise StoreError(f"{path}: lacks the columns {', '.join(lacking)}; generate it again")
    rows = sorted(held.rows, key=lambda row: tuple(row[name] for name in KEY))
    found = [row for row in rows if not row["error"]]
    if not found:
        raise ValueError(f"{path}: holds no episodes; make them with foresight generate")
    return found
