"""The crosswalk for one agent: `gymnasium.make("foresight/Crosswalk-v0")`.

The user controls pedestrian 0; the others behave as module `crosswalk` says, where spaces, rewards,
ends of episodes, options and information are described too.
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from jaxtyping import Float, Float32

from foresight_env.envs.checks import no_type_check
from foresight_env.envs.crosswalk import CrosswalkParallelEnv, Info
from foresight_env.envs.overlay import Overlay
from foresight_env.envs.scene import Scene, agent_name

EGO = agent_name(0)


class CrosswalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Pedestrian 0 among others; takes the arguments of `parallel_env` except `controlled`."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        name: CrosswalkParallelEnv.metadata[name] for name in ("render_modes", "render_fps")
    }

    @no_type_check
    def __init__(self, **arguments: Any) -> None:
        if "controlled" in arguments:
            raise ValueError("controlled: is always (0,) here; use parallel_env for other choices")
        self._world = CrosswalkParallelEnv(controlled=(0,), **arguments)
        self.render_mode = self._world.render_mode
        self.observation_space = self._world.observation_space(EGO)
        self.action_space = self._world.action_space(EGO)

    @property
    def scene(self) -> Scene:
        """What the agent's policy may know."""
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
        return observations[EGO], infos[EGO]

    @no_type_check
    def step(
        self, action: Float[np.ndarray, "2"]
    ) -> tuple[Float32[np.ndarray, "size"], float, bool, bool, Info]:
        """Move everybody by one step."""
        seen, rewards, terminated, truncated, infos = self._world.step({EGO: action})
        return seen[EGO], rewards[EGO], terminated[EGO], truncated[EGO], infos[EGO]

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
