"""Value of information: egos and an upper bound on the same episodes, per setting.

The value of information of a setting is what the baseline `assume-gamma-1` loses to the bound, the
clairvoyant: the best of the egos' own actions and of those that a search finds, so that it is never
negative. A setting in which it is nothing cannot show that anything is gained by inferring.

How costs, harm and times are compared is in `studies.value_summary`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from agents import make_ego
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.rollout.clairvoyant import CLAIRVOYANT, Clairvoyant
from evaluation.rollout.endings import ending
from evaluation.rollout.episode import run_episode, warm_up
from evaluation.rollout.places import SETTINGS

KEY = ("setting", "ego", "settings", "seed")
BASELINE = "assume-gamma-1"
"""Ego whose loss against the bound is measured."""


def run_trial(setting: str, ego: str, settings: str, seed: int, safety_filter: bool) -> Row:
    """One episode's row; `settings` distinguishes egos of the same name in the store."""
    chosen = replace(SETTINGS[setting], safety_filter=safety_filter)
    warm_up(chosen, ego)
    found = run_episode(chosen, ego, seed)
    return {
        "ended": ending(found.last),
        "time": float(found.last["time"]),
        "time_limit": found.time_limit,
        "min_gap": float(found.last["min_distance"]),
        "cost": found.cost,
        **found.counts,
        "latencies": found.latencies,
        "actions": [step.decision.action.tolist() for step in found.steps],
    }


def run_bound(
    setting: str, ego: str, settings: str, seed: int, given: list[list[list[float]]]
) -> Row:
    """The clairvoyant's row of an episode, from the actions of the egos."""
    env = SETTINGS[setting].make()
    actions = [np.array(own, dtype=np.float32) for own in given]
    found = Clairvoyant().respond(env, seed, SETTINGS[setting].gammas, actions)
    return {
        "ended": found.ended,
        "time": float(found.info["time"]),
        "time_limit": env.scene.max_steps * env.scene.dt,
        "min_gap": float(found.info["min_distance"]),
        "cost": found.score.cost,
        "actions": found.actions.tolist(),
    }


def study(
    folder: str | Path,
    settings: Sequence[str],
    egos: Sequence[str],
    seeds: range,
    *,
    workers: Workers = None,
    clairvoyant: bool = True,
    safety_filter: bool = True,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder`: in every setting every ego, then the clairvoyant, on every seed.

    Episodes that the folder has already are not run again, unless `fresh`.
    """
    rule = {"safety_filter": safety_filter}
    store = Store(folder, "value of information", rule, KEY, fresh=fresh)
    prints = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials: list[Trial] = [
        {"setting": setting, "ego": ego, "settings": prints[ego], "seed": seed, **rule}
        for setting in settings
        for seed in seeds
        for ego in egos
    ]
    rows = run_trials(
        run_trial, trials, store, workers=workers, label="value", programs=("setting", "ego")
    )
    if not clairvoyant:
        return rows
    # Its bound holds for the egos whose actions it was given, so these are part of its settings.
    own = json.dumps([fingerprint(Clairvoyant()), *sorted(prints.values())])
    given = _actions(rows)
    bounds: list[Trial] = [
        {
            "setting": setting,
            "ego": CLAIRVOYANT,
            "settings": own,
            "seed": seed,
            "given": given[setting, seed],
        }
        for setting in settings
        for seed in seeds
        if (setting, seed) in given
    ]
    return rows + run_trials(
        run_bound, bounds, store, workers=workers, label="clairvoyant", programs=("setting",)
    )


def _actions(rows: Sequence[Row]) -> dict[tuple[str, int], list[list[list[float]]]]:
    """All egos' actions per setting and seed."""
    found: dict[tuple[str, int], list[list[list[float]]]] = {}
    for row in rows:
        if not row["error"]:
            found.setdefault((row["setting"], row["seed"]), []).append(row["actions"])
    return found
