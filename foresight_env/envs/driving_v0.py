"""Version 0 of driving under PettingZoo's names; `driving.env` has its page."""

from typing import Any

from pettingzoo.utils.conversions import aec_wrapper_fn, parallel_to_aec_wrapper

from foresight_env.envs.driving.env import DrivingParallelEnv

__all__ = ["env", "parallel_env", "raw_env"]

parallel_env = DrivingParallelEnv
"""The parallel environment; arguments as in `driving.env`."""

env = aec_wrapper_fn(parallel_env)
"""The same as an agent-environment-cycle environment that enforces the order of calls."""


def raw_env(**arguments: Any) -> Any:
    """The agent-environment-cycle form without the wrapper that enforces the order of calls."""
    return parallel_to_aec_wrapper(parallel_env(**arguments))
