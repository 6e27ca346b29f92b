"""Scenario of an environment, without its episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from foresight_env.envs.core.scene import GOALS, OpponentPrior, Population
from foresight_env.envs.rendering.scenery import Scenery
from foresight_env.games import Game
from foresight_env.games.footprints import Footprint
from foresight_env.scenarios.episode_parameters import EpisodeParameters

Gaps = Callable[
    [Float[np.ndarray, "N n"], Float[np.ndarray, "N m"], Float[np.ndarray, "N n"]],
    Float[np.ndarray, "N N"],
]
"""From states, controls and the states that follow: the smallest signed gap (m) between each pair
during that step, infinite for pairs that may touch."""


def no_player(states: Float[np.ndarray, "N n"]) -> Bool[np.ndarray, "N"]:
    """No agent is off the road where there is none."""
    return np.zeros(len(states), dtype=bool)


@dataclass(frozen=True)
class World:
    """A scenario as an environment sees it; arrays have one row per player."""

    names: tuple[str, ...]
    """Of the players' agents."""
    game: Callable[[int], Game]
    """The game over so many stages."""
    draw: Callable[[np.random.Generator], EpisodeParameters]
    """An episode's hidden truth."""
    gaps: Gaps
    shown_low: Float[np.ndarray, "N n"]
    shown_high: Float[np.ndarray, "N n"]
    """Limits of each state in observations; goals lie in the range of positions."""
    goal_radius: Float[np.ndarray, "N"]
    """Distance from its goal within which an agent has reached it, m."""
    footprints: tuple[Footprint, ...]
    scenery: Scenery
    opponent_prior: OpponentPrior = GOALS
    """Prior of agents about others."""
    population: Population | None = None
    """Prior of the agents before any is observed."""
    routes: tuple[Float[np.ndarray, "_ 4"], ...] = ()
    """Centre lines of vehicles' routes: points `[px, py, heading, curvature]`, 1 m apart."""
    off_road: Callable[[Float[np.ndarray, "N n"]], Bool[np.ndarray, "N"]] = no_player
    """Agents that are off the road."""

    @property
    def players(self) -> int:
        """How many agents there are, controlled or not."""
        return len(self.names)

    @property
    def turns(self) -> Bool[np.ndarray, "N"]:
        """Players whose states end with a heading: those with a length and a width."""
        return np.array([footprint.length > 0.0 for footprint in self.footprints])

    def parameters(self) -> tuple[dict[str, tuple[int, ...]], ...]:
        """Names and shapes of every player's cost parameters."""
        drawn = self.draw(np.random.default_rng(0)).theta
        return tuple({name: np.shape(value) for name, value in own.items()} for own in drawn)


def stacked(theta: tuple[dict[str, Any], ...]) -> dict[str, np.ndarray]:
    """Parameters by name, one row per player; 0 for players that do not have one."""
    names = {name: np.shape(value) for own in theta for name, value in own.items()}
    return {
        name: np.stack([np.asarray(own.get(name, np.zeros(shape))) for own in theta])
        for name, shape in names.items()
    }


def unstacked(theta: dict[str, Any], player: int) -> dict[str, np.ndarray]:
    """One player's parameters out of what `stacked` made."""
    own = {name: np.asarray(values)[player] for name, values in theta.items()}
    # Weights and distances are above 0; a goal may well be the origin.
    return {name: value for name, value in own.items() if value.ndim or value != 0.0}
