"""Places of the benchmark: the environments, each by the name that tables show."""

from __future__ import annotations

from evaluation.rollout.setting import RunSetting
from foresight_env.names import PLACES, SCENE_NAMES


def setting_of(place: str, others: str = "receding") -> RunSetting:
    """The environment of that name; `others`: what drives the agents beside the ego."""
    if place in SCENE_NAMES:
        return RunSetting("driving", scene=place, behaviour=others)
    if place not in PLACES:
        raise ValueError(f"place: {place!r} is unknown; choose from {', '.join(PLACES)}")
    return RunSetting(place, behaviour=others)


def is_driving(place: str) -> bool:
    """Whether cars on highway-env's roads are driven there."""
    return place in SCENE_NAMES
