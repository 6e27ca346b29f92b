"""Environments for one agent: `gymnasium.make("foresight/Crosswalk-v0")` and its siblings.

The user controls one player, the others behave as the parallel environment's module says, where
spaces, rewards, ends of episodes, options and information are described too.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float, Float32

from foresight_env.annotations import no_type_check
from foresight_env.envs.core.parallel import Info, WorldParallelEnv
from foresight_env.envs.core.scene import Scene
from foresight_env.envs.rendering.overlay import Overlay


class SingleAgentEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One agent of a parallel environment; takes that one's arguments except `controlled`."""

    def __init__(self, parallel: type[WorldParallelEnv], ego: int, arguments: Any) -> None:
        if "controlled" in arguments:
            raise ValueError(
                f"controlled: is always ({ego},) here; use parallel_env for other choices"
            )
        self._world = parallel(controlled=(ego,), **arguments)
        (self._ego,) = self._world.possible_agents
        self.render_mode = self._world.render_mode
        self.observation_space = self._world.observation_space(self._ego)
        self.action_space = self._world.action_space(self._ego)

    @property
    def scene(self) -> Scene:
        """Scene of the episode, for the agent's policy."""
        return self._world.scene

    @no_type_check
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32[np.ndarray, "size"], Info]:
        """Begin an episode."""
        observations, infos = self._world.reset(seed=seed, options=options)
        super().reset(seed=seed)
        # One stream of random numbers: Gymnasium's is the world's.
        self.np_random = self._world.np_random
        return observations[self._ego], infos[self._ego]

    @no_type_check
    def step(
        self, action: Float[np.ndarray, "2"]
    ) -> tuple[Float32[np.ndarray, "size"], float, bool, bool, Info]:
        """Move all agents by one step."""
        seen, rewards, terminated, truncated, infos = self._world.step({self._ego: action})
        ego = self._ego
        return seen[ego], rewards[ego], terminated[ego], truncated[ego], infos[ego]

    @no_type_check
    def set_overlay(self, overlay: Overlay) -> None:
        """Draw this over the scene from now on, until the next call or `reset`."""
        self._world.set_overlay(overlay)

    def render(self) -> np.ndarray | None:
        """The current frame, (H, W, 3) uint8; None with `"human"`."""
        return self._world.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self._world.close()


def single_metadata(parallel: type[WorldParallelEnv]) -> dict[str, Any]:
    """Metadata of a Gymnasium environment from its parallel one."""
    return {name: parallel.metadata[name] for name in ("render_modes", "render_fps")}
