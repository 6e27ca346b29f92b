"""Closed-loop settings by name: the published places, and those where foresight may pay.

`foresight value` measures what knowing the others' discount factors is worth in each
(docs/measurements.md). Settings were chosen on `DEVELOPMENT_SEEDS`; numbers on `TEST_SEEDS` are of
one run per version.
"""

from __future__ import annotations

from dataclasses import replace

from evaluation.rollout.setting import RunSetting
from foresight_env.names import PLACES, SCENE_NAMES

DEVELOPMENT_SEEDS = range(1000, 1040)
"""Episodes on which settings, and what an upper bound searches, are chosen."""
TEST_SEEDS = range(200)
"""Episodes of which results are published; studies take as many of the first as they need."""

SETTINGS: dict[str, RunSetting] = {
    **{
        place: RunSetting("driving", scene=place) if place in SCENE_NAMES else RunSetting(place)
        for place in PLACES
    },
    "crowd-3-short": RunSetting("crosswalk", players=3, others_gamma=(0.2, 0.7)),
    "crowd-4-short": RunSetting("crosswalk", players=4, others_gamma=(0.2, 0.7)),
    "crowd-4-far": RunSetting("crosswalk", players=4, others_gamma=(0.7, 1.0)),
    "left_turn-25": RunSetting("driving", "left_turn", planning_horizon=25),
    "merge-25": RunSetting("driving", "merge", planning_horizon=25),
    "roundabout-25": RunSetting("driving", "roundabout", planning_horizon=25),
}
"""Settings by name. A number after `crowd-` counts walkers, `short` and `far` are their foresight;
a number after a driving scene is the planning horizon in steps of 0.1 s (the paper's is 11)."""


def setting_of(name: str, others: str = "receding") -> RunSetting:
    """The setting of that name; `others`: what drives the agents beside the ego."""
    if name not in SETTINGS:
        raise ValueError(f"setting: {name!r} is unknown; choose from {', '.join(SETTINGS)}")
    return replace(SETTINGS[name], behaviour=others)


def is_driving(name: str) -> bool:
    """Whether cars on highway-env's roads are driven there."""
    return setting_of(name).scenario == "driving"
