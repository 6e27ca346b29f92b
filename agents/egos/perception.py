"""Perception of an ego without a game: all agents' present states by straight, even motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.motion import FIT_STEPS, extrapolate, player_positions, present_state
from agents.egos.own_state import OwnState, follow_own_state
from agents.egos.planning import within_limits
from agents.interfaces.policy import Decision
from foresight_env.envs.core.motion import braking
from foresight_env.envs.core.scene import Scene


class Perception(NamedTuple):
    """Recent observations, all agents' states by them, and the ego's own state."""

    scene: Scene
    ego: int
    observations: tuple[Float[np.ndarray, "size"], ...] = ()
    own: OwnState = OwnState()
    known: tuple[Float[np.ndarray, "4"] | None, ...] = ()
    """All agents' present states by straight, even motion, also out of sight; None before an agent
    was seen."""
    guessed: bool = False
    """Whether an agent was seen only once, a position without a velocity: taken to be at rest."""

    def taking(self, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]) -> Perception:
        """Return the same after an observation, whose last two entries are the goal.

        The ego's `applied_action` in `info` replaces the one that `acted` recorded: a safety filter
        or a limit may have changed it.
        """
        applied = info.get("applied_action")
        own = self.own
        if applied is not None and own.action is not None:
            own = own.acted(applied)
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
            own=follow_own_state(self.scene, self.ego, model, own, seen),
            known=tuple(known),
            guessed=guessed,
        )

    def _seen_entries(self, j: int) -> int:
        """How many entries of a player's state observations show."""
        return self.scene.observation_model(self.ego).owners.count(j)

    def _further(self, j: int, state: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
        return extrapolate(self.scene.game.players[j].dynamics, state, 1, self.scene.dt)[0]

    def acted(self, action: Float[np.ndarray, "m"]) -> Perception:
        """Return the same with the ego's action until the next observation."""
        return self._replace(own=self.own.acted(action))

    @property
    def missing(self) -> bool:
        """Whether an agent was never seen yet: there is no game to plan in."""
        if not self.observations:
            raise ValueError("memory: holds no observation yet; call update before act")
        return any(state is None for state in self.known)

    def states(self) -> list[Float[np.ndarray, "4"]]:
        """Present states: the ego's own by its actions, the others' by straight, even motion."""
        if self.missing:
            raise ValueError("memory: an agent was never observed; act by waiting()")
        found = [state for state in self.known if state is not None]
        if self.own.mean is not None:
            found[self.ego] = self.own.mean
        return found

    def waiting(self) -> tuple[Decision, Perception]:
        """Decision while an agent was never seen: brake, or zero where the ego is not seen."""
        state = self.known[self.ego] if self.own.mean is None else self.own.mean
        game = self.scene.game
        action = np.zeros(game.players[self.ego].dynamics.control_size)
        if state is not None:
            action = braking(game, self.ego, state)
        action = within_limits(game, self.ego, action).astype(np.float32)
        return Decision(action, plan_fallback=True), self.acted(action)
