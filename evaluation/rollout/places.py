"""Closed-loop settings by name: the published places, and those for the value of information.

`foresight value` measures the value of knowing the others' discount factors in each
(docs/measurements.md). Settings were chosen on `DEVELOPMENT_SEEDS`; numbers on `TEST_SEEDS` are of
one run per version.
"""

from __future__ import annotations

from dataclasses import replace

from evaluation.rollout.setting import RunSetting
from foresight_env.names import PLACES, SCENE_NAMES

DEVELOPMENT_SEEDS = range(1000, 1050)
"""Episodes on which settings, and what an upper bound searches, are chosen."""
TEST_SEEDS = range(200)
"""Episodes of which results are published; studies take as many of the first as they need."""


def _crowd(walkers: int, least: float, most: float) -> RunSetting:
    """Walkers whose discount factors lie between these."""
    return RunSetting("crosswalk", players=walkers, others_gamma=(least, most))


SETTINGS: dict[str, RunSetting] = {
    **{
        place: RunSetting("driving", scene=place) if place in SCENE_NAMES else RunSetting(place)
        for place in PLACES
    },
    **{f"crowd-{walkers}": _crowd(walkers, 0.2, 1.0) for walkers in (2, 4, 6)},
    "crowd-3-short": _crowd(3, 0.2, 0.7),
    "crowd-4-short": _crowd(4, 0.2, 0.7),
    "crowd-4-medium": _crowd(4, 0.5, 0.9),
    "crowd-3-far": _crowd(3, 0.7, 1.0),
    "crowd-4-far": _crowd(4, 0.7, 1.0),
    "left_turn-2.5s": RunSetting("driving", "left_turn", planning_horizon=25),
    **{
        f"{scene}-4s": RunSetting("driving", scene, planning_horizon=20, step=0.2)
        for scene in ("left_turn", "merge", "roundabout")
    },
    "left_turn-4s-short": RunSetting(
        "driving", "left_turn", planning_horizon=20, step=0.2, others_gamma=(0.3, 0.7)
    ),
}
"""Settings by name. `crowd-N`: N walkers at the crosswalk with any foresight;
`crowd-N-FORESIGHT`: with short, medium or far foresight. `SCENE-SECONDS`: a driving scene in which
all plan so far ahead, in steps of 0.1 s (2.5s) or 0.2 s (4s); the horizon of the scene's plain
name, the paper's, is 1.1 s. Discount factors count per step."""


def setting_of(name: str, others: str = "receding") -> RunSetting:
    """The setting of that name; `others`: what drives the agents other than the ego."""
    if name not in SETTINGS:
        raise ValueError(f"setting: {name!r} is unknown; choose from {', '.join(SETTINGS)}")
    return replace(SETTINGS[name], behaviour=others)


def is_driving(name: str) -> bool:
    """Whether cars on highway-env's roads are driven there."""
    return setting_of(name).scenario == "driving"
