"""The state of one episode of the crosswalk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from foresight_env.envs.motion import closest_approach
from foresight_env.scenarios.crosswalk import COLLISION_DISTANCE, Crossing

GOAL_RADIUS = 0.25
"""Distance from its goal within which an agent has reached it, m."""


@dataclass
class Episode:
    """All that changes between `reset` and the end; never handed out."""

    crossing: Crossing
    noise: np.random.Generator
    states: Float[np.ndarray, "N 4"]
    controls: Float[np.ndarray, "N 2"]
    """As applied in the last step, m/s^2."""
    closest: Float[np.ndarray, "N"]
    """Smallest distance of each player's centre to another's so far, m."""
    collided: Bool[np.ndarray, "N"]
    reached: Bool[np.ndarray, "N"]
    trail: list[Float[np.ndarray, "N 2"]] = field(default_factory=list)
    """Positions so far, m."""
    steps: int = 0

    @staticmethod
    def begin(crossing: Crossing, noise: np.random.Generator) -> Episode:
        """The episode at its first instant."""
        states = crossing.initial_states.copy()
        players = len(states)
        controls = np.zeros((players, 2))
        closest = closest_approach(states, controls, 0.0).min(axis=1)
        nobody = np.zeros(players, dtype=bool)
        episode = Episode(crossing, noise, states, controls, closest, nobody, nobody.copy())
        episode.arrive(states)
        return episode

    def advance(
        self,
        controls: Float[np.ndarray, "N 2"],
        distances: Float[np.ndarray, "N"],
        states: Float[np.ndarray, "N 4"],
    ) -> None:
        """One step with these controls, closest approaches on the way, and states at its end."""
        self.controls = controls
        self.closest = np.minimum(self.closest, distances)
        self.collided = self.closest < COLLISION_DISTANCE
        self.steps += 1
        self.arrive(states)

    def arrive(self, states: Float[np.ndarray, "N 4"]) -> None:
        """Take up new states and note whose goal is reached."""
        self.states = states
        self.trail.append(states[:, :2].copy())
        goals = np.stack([own["goal"] for own in self.crossing.theta])
        self.reached = self.reached | (np.linalg.norm(states[:, :2] - goals, axis=1) <= GOAL_RADIUS)
