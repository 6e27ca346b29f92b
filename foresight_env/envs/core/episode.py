"""The state of one episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from foresight_env.envs.core.world import World
from foresight_env.scenarios.episode_parameters import EpisodeParameters


@dataclass
class EpisodeState:
    """All that changes between `reset` and the end; never handed out."""

    world: World
    episode_parameters: EpisodeParameters
    noise: np.random.Generator
    states: Float[np.ndarray, "N n"]
    controls: Float[np.ndarray, "N m"]
    """As applied in the last step."""
    closest: Float[np.ndarray, "N"]
    """Smallest gap between each player's footprint and another's so far, m; negative: overlap."""
    collided: Bool[np.ndarray, "N"]
    reached: Bool[np.ndarray, "N"]
    off_road: Bool[np.ndarray, "N"]
    """Players that have been off the road so far."""
    trail: list[Float[np.ndarray, "N 2"]] = field(default_factory=list)
    """Positions so far, m."""
    steps: int = 0

    @staticmethod
    def begin(
        world: World, episode_parameters: EpisodeParameters, noise: np.random.Generator
    ) -> EpisodeState:
        """The episode at its first instant."""
        states = episode_parameters.initial_state.copy()
        controls = np.zeros((len(states), world.game(1).players[0].dynamics.control_size))
        closest = world.gaps(states, controls, states).min(axis=1)
        no = np.zeros(len(states), dtype=bool)
        episode = EpisodeState(
            world, episode_parameters, noise, states, controls, closest, no, no.copy(), no.copy()
        )
        episode.arrive(states)
        return episode

    def advance(self, controls: Float[np.ndarray, "N m"], states: Float[np.ndarray, "N n"]) -> None:
        """One step with these controls to these states."""
        self.controls = controls
        gaps = self.world.gaps(self.states, controls, states)
        self.closest = np.minimum(self.closest, gaps.min(axis=1))
        self.collided = self.closest < 0.0
        self.steps += 1
        self.arrive(states)

    def arrive(self, states: Float[np.ndarray, "N n"]) -> None:
        """Take up new states and note who has reached its goal, and who left the road."""
        self.states = states
        self.trail.append(states[:, :2].copy())
        self.off_road = self.off_road | self.world.off_road(states)
        goals = np.stack([own["goal"] for own in self.episode_parameters.theta])
        distances = np.linalg.norm(states[:, :2] - goals, axis=1)
        self.reached = self.reached | (distances <= self.world.goal_radius)
