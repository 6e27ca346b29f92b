"""Makes the environments known to Gymnasium and PettingZoo by id."""

from __future__ import annotations

from gymnasium.envs.registration import register as register_gymnasium
from gymnasium.envs.registration import registry
from pettingzoo.env_registry.registration import aec_registry, parallel_registry
from pettingzoo.env_registry.registration import register as register_pettingzoo

from foresight_env.names import SCENARIOS

# Each scenario has a module `<name>.env` with a class `<Name>Env`, and a module `<name>_v0`.

VECTOR = {"crosswalk": "foresight_env.envs.crosswalk.vector:CrosswalkVectorEnv"}
"""Vector environment of `gymnasium.make_vec(..., vectorization_mode="vector_entry_point")`."""


def register() -> None:
    """Register every environment that is not registered yet; importing the package does it."""
    for name in SCENARIOS:
        single, both = f"foresight/{name.capitalize()}-v0", f"foresight/{name}-v0"
        module = f"foresight_env.envs.{name}_v0"
        if single not in registry:
            register_gymnasium(
                single,
                f"foresight_env.envs.{name}.env:{name.capitalize()}Env",
                vector_entry_point=VECTOR.get(name),
            )
        if both not in parallel_registry:
            register_pettingzoo("parallel", both, f"{module}:parallel_env")
        if both not in aec_registry:
            register_pettingzoo("aec", both, f"{module}:env")
