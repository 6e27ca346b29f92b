"""Makes the environments known to Gymnasium and PettingZoo by id."""

from __future__ import annotations

from gymnasium.envs.registration import register as register_gymnasium
from gymnasium.envs.registration import registry
from pettingzoo.env_registry.registration import aec_registry, parallel_registry
from pettingzoo.env_registry.registration import register as register_pettingzoo

GYMNASIUM_ID = "foresight/Crosswalk-v0"
PETTINGZOO_ID = "foresight/crosswalk-v0"


def register() -> None:
    """Register every environment that is not registered yet; importing the package does it."""
    if GYMNASIUM_ID not in registry:
        register_gymnasium(GYMNASIUM_ID, "foresight_env.envs.single:CrosswalkEnv")
    if PETTINGZOO_ID not in parallel_registry:
        entry_point = "foresight_env.envs.crosswalk_v0:parallel_env"
        register_pettingzoo("parallel", PETTINGZOO_ID, entry_point)
    if PETTINGZOO_ID not in aec_registry:
        register_pettingzoo("aec", PETTINGZOO_ID, "foresight_env.envs.crosswalk_v0:env")
