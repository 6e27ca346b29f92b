"""The value of information from the rows of `studies.value`, and the share of it that an ego gets.

**Score.** A collision, or leaving the road, ends an episode early, and what it would have cost with
it; so costs are compared on those seeds alone on which none of the compared egos is harmed (the
baseline and the bound; for the share that an ego closes, all three). Harm is compared on all seeds,
by McNemar's exact test. Costs are undiscounted. The time to the goal is compared on all seeds, and
is the time limit where the goal was not reached, whatever the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evaluation.execution.store import Row
from evaluation.metrics.statistics import (
    Interval,
    exact_mcnemar,
    mean_interval,
    ratio_interval,
)
from evaluation.rollout.endings import harmed, time_to_goal
from evaluation.studies.value import BASELINE


class Compared(NamedTuple):
    """Loss of the baseline to another ego in one setting; means over paired seeds."""

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
    unharmed: int
    """Seeds on which none of the three is harmed: those of `cost`."""


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
    """Loss of the baseline to `other`; None where they have no seed in common."""
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
    return Share(cost, harm, len(good))
