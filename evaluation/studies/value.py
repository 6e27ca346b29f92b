"""What knowing the others is worth: egos and an upper bound on the same episodes, per setting.

The value of information of a setting is what the baseline `assume-gamma-1` loses to the bound. A
setting in which it is nothing cannot show that anything is gained by inferring.

**Score.** A collision, or leaving the road, ends an episode early, and what it would have cost with
it; so costs are compared on those seeds alone on which none of the compared egos is harmed (the
baseline and the bound; for the share that an ego closes, all three). Harm is compared on all seeds,
by McNemar's exact test. Costs are undiscounted. The time to the goal is compared on all seeds, and
is the time limit where the goal was not reached, whatever the reason.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agents import make_ego
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.statistics import (
    Interval,
    exact_mcnemar,
    mean_interval,
    ratio_interval,
)
from evaluation.rollout.clairvoyant import CLAIRVOYANT, Clairvoyant
from evaluation.rollout.endings import HARM, REACHED, ending
from evaluation.rollout.episode import run_episode, warm_up
from evaluation.rollout.places import SETTINGS

KEY = ("setting", "ego", "settings", "seed")
BASELINE = "assume-gamma-1"
EGOS = ("oracle", "know-gamma", "infer-gamma", BASELINE, "constant-velocity")
"""That are compared, and whose actions the clairvoyant is given."""


def run_trial(setting: str, ego: str, settings: str, seed: int) -> Row:
    """One episode's row; `settings` tells egos of the same name apart in the store."""
    chosen = SETTINGS[setting]
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
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder`: in every setting every ego, then the clairvoyant, on every seed.

    Episodes that the folder has already are not run again, unless `fresh`.
    """
    store = Store(folder, "value of information", {}, KEY, fresh=fresh)
    prints = {ego: fingerprint(make_ego(ego)) for ego in egos}
    trials: list[Trial] = [
        {"setting": setting, "ego": ego, "settings": prints[ego], "seed": seed}
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


class Compared(NamedTuple):
    """What the baseline loses to another ego in one setting; means over paired seeds."""

    seeds: int
    """That both finished."""
    unharmed: int
    """Of these, on which neither was harmed: those of `cost`."""
    cost: Interval | None
    """Baseline minus the other; None where one of the two is always harmed."""
    relative_cost: float
    """The same as a part of the baseline's cost on these seeds."""
    time: Interval
    """To the goal, s, baseline minus the other."""
    harmed: tuple[int, int]
    """Episodes in which the baseline was harmed, and the other."""
    p_value: float
    """Of McNemar's exact test that harm is as likely with both."""


class Share(NamedTuple):
    """Part of the gap between baseline and bound that an ego closes; None: there is no gap."""

    cost: Interval | None
    harm: float | None


def harmed(row: Row) -> bool:
    """Whether an episode ended in a collision or off the road."""
    return row["ended"] in HARM


def time_to_goal(row: Row) -> float:
    """Seconds, the time limit where the goal was not reached."""
    return float(row["time"] if row["ended"] == REACHED else row["time_limit"])


def episodes_of(rows: Sequence[Row], setting: str, ego: str) -> dict[int, Row]:
    """An ego's finished episodes in one setting by seed."""
    return {
        row["seed"]: row
        for row in rows
        if (row["setting"], row["ego"]) == (setting, ego) and not row["error"]
    }


def compare(
    rows: Sequence[Row], setting: str, other: str, baseline: str = BASELINE
) -> Compared | None:
    """What the baseline loses to `other`; None where they have no seed in common."""
    one, two = episodes_of(rows, setting, baseline), episodes_of(rows, setting, other)
    both = sorted(one.keys() & two.keys())
    if not both:
        return None
    good = [s for s in both if not (harmed(one[s]) or harmed(two[s]))]
    costs = np.array([one[s]["cost"] - two[s]["cost"] for s in good])
    times = np.array([time_to_goal(one[s]) - time_to_goal(two[s]) for s in both])
    first, second = (np.array([harmed(own[s]) for s in both]) for own in (one, two))
    return Compared(
        len(both),
        len(good),
        mean_interval(costs) if good else None,
        float(costs.sum() / sum(one[s]["cost"] for s in good)) if good else float("nan"),
        mean_interval(times),
        (int(first.sum()), int(second.sum())),
        exact_mcnemar(first, second),
    )


def share(
    rows: Sequence[Row], setting: str, ego: str, bound: str, baseline: str = BASELINE
) -> Share:
    """Part of the gap between `baseline` and `bound` that `ego` closes.

    Of the cost: where the gap's 95 % interval is above 0, on seeds where none of the three is
    harmed. Of harm: where McNemar's test finds a gap at 5 %.
    """
    base, best, mine = (episodes_of(rows, setting, name) for name in (baseline, bound, ego))
    all_seeds = sorted(base.keys() & best.keys() & mine.keys())
    good = [s for s in all_seeds if not any(harmed(own[s]) for own in (base, best, mine))]
    gain = np.array([base[s]["cost"] - mine[s]["cost"] for s in good])
    gap = np.array([base[s]["cost"] - best[s]["cost"] for s in good])
    cost = ratio_interval(gain, gap) if good and mean_interval(gap).low > 0.0 else None
    first, least, own = (
        np.array([harmed(of[s]) for s in all_seeds], dtype=bool) for of in (base, best, mine)
    )
    saved = int(first.sum()) - int(least.sum())
    certain = saved > 0 and exact_mcnemar(first, least) < 0.05
    harm = (int(first.sum()) - int(own.sum())) / saved if certain else None
    return Share(cost, harm)
