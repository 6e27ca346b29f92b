"""What an ego without a game remembers of what it saw: where everybody is and how they move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.motion import FIT_STEPS, extrapolate, player_positions, present_state
from agents.egos.own_state import OwnState, follow_own_state
from agents.egos.planning import within_limits
from agents.interfaces.policy import Decision
from foresight_env.envs.core.motion import braking
from foresight_env.envs.core.scene import Scene


class Perception(NamedTuple):
    """Recent observations, where everybody is by them, and the ego's own state."""

    scene: Scene
    ego: int
    observations: tuple[Float[np.ndarray, "size"], ...] = ()
    own: OwnState = OwnState()
    known: tuple[Float[np.ndarray, "4"] | None, ...] = ()
    """Everybody's state now by straight, even motion, also of those who are out of sight; None of
    whom was never seen."""
    guessed: bool = False
    """Whether somebody has only just been seen, at a place without a velocity: at rest, it says."""

    def taking(self, observation: Float[np.ndarray, "size"]) -> Perception:
        """With an observation of the environment, whose last two entries are the goal."""
        seen = np.asarray(observation[:-2], dtype=float)
        model = self.scene.observation_model(self.ego)
        observations = (*self.observations, seen)[-FIT_STEPS:]
        recent = np.stack(observations)
        known: list[np.ndarray | None] = []
        guessed = False
        for j, player in enumerate(self.scene.game.players):
            before = self.known[j] if self.known else None
            shown = ~np.isnan(player_positions(model, recent, j)).any(axis=1)
            if not shown[-1]:
                known.append(None if before is None else self._further(j, before))
                continue
            state = present_state(player.dynamics, model, recent, j, self.scene.dt)
            if shown.sum() == 1 and self._seen_entries(j) < 4:
                # A place alone says nothing of motion: as it went on before, if that is known.
                guessed |= before is None
                state = state if before is None else np.concatenate([state[:2], before[2:]])
            known.append(state)
        return self._replace(
            observations=observations,
            own=follow_own_state(self.scene, self.ego, model, self.own, seen),
            known=tuple(known),
            guessed=guessed,
        )

    def _seen_entries(self, j: int) -> int:
        """How many entries of a player's state observations show."""
        return self.scene.observation_model(self.ego).owners.count(j)

    def _further(self, j: int, state: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
        return extrapolate(self.scene.game.players[j].dynamics, state, 1, self.scene.dt)[0]

    def acted(self, action: Float[np.ndarray, "m"]) -> Perception:
        """With what the ego does until the next observation."""
        return self._replace(own=self.own.acted(action))

    @property
    def missing(self) -> bool:
        """Whether somebody who takes part was never seen yet: there is no game to plan in."""
        if not self.observations:
            raise ValueError("memory: holds no observation yet; call update before act")
        return any(state is None for state in self.known)

    def states(self) -> list[Float[np.ndarray, "4"]]:
        """Where everybody is: the ego by what it did, the others by straight, even motion."""
        if self.missing:
            raise ValueError("memory: somebody was never seen; a decision is to wait")
        found = [state for state in self.known if state is not None]
        if self.own.mean is not None:
            found[self.ego] = self.own.mean
        return found

    def waiting(self) -> tuple[Decision, Perception]:
        """What to do while somebody was never seen: brake, or nothing where the ego is not seen."""
        state = self.known[self.ego] if self.own.mean is None else self.own.mean
        game = self.scene.game
        action = np.zeros(game.players[self.ego].dynamics.control_size)
        if state is not None:
            action = braking(game, self.ego, state)
        action = within_limits(game, self.ego, action).astype(np.float32)
        return Decision(action, plan_fallback=True), self.acted(action)
