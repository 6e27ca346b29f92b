"""The crosswalk: short-sighted agents cross diagonally (paper, section VI-A).

Defined once, for the environment, the estimator and the evaluation. Units: metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games.constraints import (
    Bounds,
    Inequality,
    MinimumDistance,
    SharedInequality,
    SharedMinimumDistance,
)
from foresight_env.games.costs import Effort, Goal, SquaredDistanceHinge
from foresight_env.games.dynamics import DoubleIntegrator
from foresight_env.games.game import Game, Player
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta
from foresight_env.scenarios.episode_parameters import EpisodeParameters
from foresight_env.scenarios.ranges import check_ranges

DT = 0.1
HORIZON = 25
SPEED_LIMIT = 0.8
"""Per axis, m/s."""
CONTROL_LIMIT = 10.0
"""Per axis, m/s^2."""
GOAL_WEIGHT = 1.0
CONTROL_WEIGHT = 0.1
COLLISION_WEIGHT = 5.0
MINIMUM_DISTANCE = 1.0
MARGIN = 1.2
"""The paper's `delta`: it compares squared distances with `delta * d_min`, both given in metres;
with these values agents keep 1.095 m apart."""
REFERENCE_DISTANCE = 1.2
"""The reference implementation's proximity begins at this distance, m."""
COLLISION_DISTANCE = 0.5
"""Agents whose centres come closer have collided: two discs of 0.25 m radius."""

Proximity = Literal["soft", "hard", "reference"]


@dataclass(frozen=True)
class ReferenceProximity(PermutationInvariant):
    """The reference implementation's collision cost: at `x_t` instead of `x_{t+1}`, t = 1..T.

    `x_1` is given, so what remains is a cost of `x_2..x_T` and none of the last state.
    """

    horizon: int
    cost: SquaredDistanceHinge

    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "others"]:
        return jnp.where(t < self.horizon, self.cost.residual(i, t, x, u, theta), -1.0)

    def loss(self, value: Float[Array, "others"], theta: Theta) -> Scalar:
        return self.cost.loss(value, theta)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.loss(self.residual(i, t, x, u, theta), theta)


def player_theta(
    goal: Any,
    *,
    goal_weight: float = GOAL_WEIGHT,
    control_weight: float = CONTROL_WEIGHT,
    collision_weight: float = COLLISION_WEIGHT,
) -> dict[str, Any]:
    """One player's parameters: goal (2,) in metres and the weights of its three costs."""
    return {
        "goal": goal,
        "goal_weight": goal_weight,
        "control_weight": control_weight,
        "collision_weight": collision_weight,
    }


@lru_cache(maxsize=64)
def crosswalk_game(
    players: int = 2, horizon: int = HORIZON, proximity: Proximity = "soft", dt: float = DT
) -> Game:
    """The game; `theta` of each player is as `player_theta` makes it.

    `proximity`: `"soft"`, the paper's `max(0, delta d_min - ||p_i - p_j||^2)` as a discounted cost;
    `"hard"`, the same as a constraint; `"reference"`, the reference implementation's squared hinge,
    not discounted.
    """
    if players < 1:
        raise ValueError(f"players: is {players}; expected at least 1")
    if proximity not in ("soft", "hard", "reference"):
        raise ValueError(f"proximity: is {proximity!r}; expected 'soft', 'hard' or 'reference'")
    free = np.inf
    inequalities: tuple[Inequality, ...] = ()
    undiscounted: tuple[ReferenceProximity, ...] = ()
    shared: tuple[SharedInequality, ...] = ()
    threshold = MARGIN * MINIMUM_DISTANCE
    if players > 1 and proximity == "soft":
        inequalities = (Inequality(MinimumDistance(threshold), players - 1, "collision_weight"),)
    elif players > 1 and proximity == "hard":
        shared = (SharedInequality(SharedMinimumDistance(threshold), players * (players - 1) // 2),)
    elif players > 1:
        hinge = SquaredDistanceHinge(REFERENCE_DISTANCE, "collision_weight")
        undiscounted = (ReferenceProximity(horizon, hinge),)
    player = Player(
        DoubleIntegrator(dt),
        (Goal("goal_weight"), Effort("control_weight")),
        undiscounted,
        state_bounds=Bounds.box(
            [-free, -free, -SPEED_LIMIT, -SPEED_LIMIT], [free, free, SPEED_LIMIT, SPEED_LIMIT], 4
        ),
        control_bounds=Bounds.box(-CONTROL_LIMIT, CONTROL_LIMIT, 2),
        inequalities=inequalities,
        extra_theta=(
            "collision_weight",
        ),  # of walkers that are alone or have a distance constraint
    )
    return Game((player,) * players, horizon, shared, dt)


class CrosswalkInstance(NamedTuple):
    """Initial states, goals and discount factors of one crossing."""

    initial_state: Float[np.ndarray, "N 4"]
    goals: Float[np.ndarray, "N 2"]
    gamma: Float[np.ndarray, "N"]

    @property
    def theta(self) -> tuple[dict[str, Any], ...]:
        """Parameters for `crosswalk_game`, weights at their defaults."""
        return tuple(player_theta(goal) for goal in self.goals)


MONTE_CARLO = CrosswalkInstance(
    np.array([[2.0, 2.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]]),
    np.array([[0.0, 0.0], [2.0, 0.0]]),
    np.array([0.95, 0.9]),
)
"""The paper's Monte Carlo study."""

HEATMAP = CrosswalkInstance(
    np.array([[0.0, 2.0, 0.1, -0.2], [2.5, 2.0, 0.0, 0.0]]),
    np.array([[2.0, 0.0], [0.0, 0.0]]),
    np.array([0.6, 0.6]),
)
"""The paper's heatmap of the inverse problem's objective."""


def nominal_setting(players: int) -> CrosswalkInstance:
    """Nominal crossing of `players` agents (2 to 6): the Monte Carlo setting, or around a circle.

    On the circle neighbours start at least 1.6 m apart and every goal lies opposite.
    """
    if not 2 <= players <= 6:
        raise ValueError(f"players: is {players}; a crosswalk has 2 to 6")
    if players == 2:
        return MONTE_CARLO
    radius = max(np.sqrt(2.0), 0.8 / np.sin(np.pi / players))
    angle = np.pi / 4 + 2.0 * np.pi * np.arange(players) / players
    start = 1.0 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    states = np.concatenate([start, np.zeros((players, 2))], axis=1)
    return CrosswalkInstance(states, 2.0 - start, np.full(players, 0.9))


LARGEST_SHIFTS = {"start": 0.35, "goal": 10.0}
"""Of `Ranges`, m: agents around the circle are not drawn on top of each other, and goals lie inside
the observation space."""


class Ranges(NamedTuple):
    """From which ranges an episode's hidden parameters are drawn, uniformly."""

    gamma: tuple[float, float] = (0.3, 1.0)
    start: float = 0.1
    """Largest shift of each start coordinate from its nominal place, m."""
    goal: float = 0.3
    """Largest shift of each goal coordinate, m."""
    control_weight: tuple[float, float] = (CONTROL_WEIGHT, CONTROL_WEIGHT)
    collision_weight: tuple[float, float] = (COLLISION_WEIGHT, COLLISION_WEIGHT)

    def check(self) -> None:
        """Raise `ValueError` where a draw might be no legal episode."""
        check_ranges(self, ("gamma", "control_weight", "collision_weight"), LARGEST_SHIFTS)


def draw_crossing(
    random: np.random.Generator, players: int, ranges: Ranges = Ranges()
) -> EpisodeParameters:
    """Draw initial states, goals, weights and discount factors around `nominal_setting`."""
    nominal = nominal_setting(players)
    states = nominal.initial_state.copy()
    states[:, :2] += random.uniform(-ranges.start, ranges.start, (players, 2))
    goals = nominal.goals + random.uniform(-ranges.goal, ranges.goal, (players, 2))
    gamma = random.uniform(*ranges.gamma, players)
    control = random.uniform(*ranges.control_weight, players)
    collision = random.uniform(*ranges.collision_weight, players)
    theta = tuple(
        player_theta(goals[i], control_weight=control[i], collision_weight=collision[i])
        for i in range(players)
    )
    return EpisodeParameters(states, theta, gamma)
