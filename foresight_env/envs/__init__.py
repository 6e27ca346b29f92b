"""Environments: PettingZoo parallel environments and Gymnasium ids, registered on import.

`foresight_env.envs.crosswalk_v0.parallel_env()` makes the multi-agent crosswalk,
`gymnasium.make("foresight/Crosswalk-v0")` the single-agent one; `intersection_v0` and
`foresight/Intersection-v0` are the intersection, `driving_v0` and `foresight/Driving-v0` cars on
highway-env's roads. Without this import, Gymnasium finds an id as
`gymnasium.make("foresight_env.envs:foresight/Crosswalk-v0")`. `scene_of(env)` is the present
episode's scene, which policies are initialised with, of an environment in any wrappers.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from foresight_env.envs.registration import register
from foresight_env.names import SCENARIOS

if TYPE_CHECKING:
    from foresight_env.envs.core.scene import scene_of as scene_of

__all__ = ["crosswalk_v0", "driving_v0", "intersection_v0", "register", "scene_of"]


def __getattr__(name: str) -> Any:
    # On demand: registering ids should not load JAX.
    if name in {f"{scenario}_v0" for scenario in SCENARIOS}:
        return import_module(f"foresight_env.envs.{name}")
    if name == "scene_of":
        return import_module("foresight_env.envs.core.scene").scene_of
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


register()
