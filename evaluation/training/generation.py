"""Data sets of simulated episodes: what was seen, what happened, and the truth that nobody sees."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evaluation.execution.local import Workers
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.rollout.episode import run_episode
from evaluation.rollout.places import setting_of
from evaluation.studies.benchmark import OPEN_SEEDS

SCHEMA = 1
"""Counted up when rows get other columns or mean something else: older folders are refused."""
KEY = ("place", "seed")
FIRST_SEED = {
    "train": 2 * OPEN_SEEDS,
    "validation": 3 * OPEN_SEEDS,
    "test": 4 * OPEN_SEEDS,
}
"""Of each split; studies of egos begin with 0, the benchmark's open loop with `OPEN_SEEDS`."""
MOST = OPEN_SEEDS
"""Episodes of a split: beyond, seeds would be those of the next."""


def run_trial(place: str, seed: int) -> Row:
    """One episode in which everybody plays the game, the ego (the oracle) as well.

    `states` (T+1, N, 4), `controls` (T, N, 2) and `observations` (T, size) are flattened.
    """
    setting = setting_of(place)
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
    if split not in FIRST_SEED:
        raise ValueError(f"split: is {split!r}; expected one of {', '.join(FIRST_SEED)}")
    if not 1 <= episodes <= MOST:
        raise ValueError(f"episodes: is {episodes}; expected 1 to {MOST}")
    store = Store(folder, f"episodes, {split}", {"schema": SCHEMA}, KEY)
    trials: list[Trial] = [
        {"place": place, "seed": FIRST_SEED[split] + k} for place in places for k in range(episodes)
    ]
    return run_trials(run_trial, trials, store, workers=workers, label=split, chunk=16)


def episodes_in(folder: str | Path, split: str) -> list[Row]:
    """The episodes of a split that a folder holds, without those that broke.

    `ValueError` where it has none, or holds something else.
    """
    path = Path(folder)
    if not (path / "manifest.json").is_file():
        raise ValueError(f"{path}: holds no episodes; make them with foresight generate")
    store = Store(path, f"episodes, {split}", {"schema": SCHEMA}, KEY)
    found = [row for row in store.rows() if not row["error"]]
    if not found:
        raise ValueError(f"{path}: holds no episodes; make them with foresight generate")
    return found
