"""What an ego without a game remembers of what it saw: where everybody is and how they move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.motion import FIT_STEPS, present_state
from agents.own_state import OwnState, follow_own_state
from foresight_env.envs.scene import Scene


class Perception(NamedTuple):
    """Recent observations, and the ego's own state."""

    scene: Scene
    ego: int
    observations: tuple[Float[np.ndarray, "size"], ...] = ()
    own: OwnState = OwnState()

    def taking(self, observation: Float[np.ndarray, "size"]) -> Perception:
        """With an observation of the environment, whose last two entries are the goal."""
        seen = np.asarray(observation[:-2], dtype=float)
        model = self.scene.observation_model(self.ego)
        return self._replace(
            observations=(*self.observations, seen)[-FIT_STEPS:],
            own=follow_own_state(self.scene, self.ego, model, self.own, seen),
        )

    def acted(self, action: Float[np.ndarray, "m"]) -> Perception:
        """With what the ego does until the next observation."""
        return self._replace(own=self.own.acted(action))

    def states(self) -> list[Float[np.ndarray, "4"]]:
        """Where everybody is: the ego by what it did, the others by straight, even motion."""
        if not self.observations:
            raise ValueError("memory: holds no observation yet; call update before act")
        model, seen = self.scene.observation_model(self.ego), np.stack(self.observations)
        found = [
            present_state(player.dynamics, model, seen, j, self.scene.dt)
            for j, player in enumerate(self.scene.game.players)
        ]
        if self.own.mean is not None:
            found[self.ego] = self.own.mean
        return found
