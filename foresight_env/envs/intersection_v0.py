"""Version 0 of the intersection under PettingZoo's names; `intersection.env` has its page."""

from typing import Any

from pettingzoo.utils.conversions import aec_wrapper_fn, parallel_to_aec_wrapper

from foresight_env.envs.intersection.env import IntersectionParallelEnv

__all__ = ["env", "parallel_env", "raw_env"]

parallel_env = IntersectionParallelEnv
"""The parallel environment; arguments as in `intersection.env`."""

env = aec_wrapper_fn(parallel_env)
"""The same as an agent-environment-cycle environment that enforces the order of calls."""


def raw_env(**arguments: Any) -> Any:
    """The agent-environment-cycle form without the wrapper that enforces the order of calls."""
    return parallel_to_aec_wrapper(parallel_env(**arguments))
