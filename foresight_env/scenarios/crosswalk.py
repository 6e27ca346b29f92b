"""The crosswalk: short-sighted agents cross diagonally (paper, section VI-A).

Defined once, for the environment, the estimator and the evaluation. Units: metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games.constraints import (
    Bounds,
    Inequality,
    KeepAllApart,
    KeepApart,
    SharedInequality,
)
from foresight_env.games.costs import Effort, Goal, SquaredDistanceHinge
from foresight_env.games.dynamics import DoubleIntegrator
from foresight_env.games.game import Game, Player
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta

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
"""The paper's `delta`: it compares squared distances with `delta * d_min`, both given in metres; with
these values agents keep 1.095 m apart."""
REFERENCE_DISTANCE = 1.2
"""The reference implementation's proximity begins at this distance, m."""
COLLISION_DISTANCE = 0.5
"""Agents whose centres come closer have collided: two discs of 0.25 m radius."""

Proximity = Literal["soft", "hard", "reference"]


@dataclass(frozen=True)
class ReferenceProximity:
    """The reference implementation's collision cost: at `x_t` instead of `x_{t+1}`, t = 1..T.

    `x_1` is given, so what remains is a cost of `x_2..x_T` and none of the last state.
    """

    horizon: int
    cost: SquaredDistanceHinge

    def inner(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "N-1"]:
        return jnp.where(t < self.horizon, self.cost.inner(i, t, x, u, theta), -1.0)

    def outer(self, value: Float[Array, "N-1"], theta: Theta) -> Scalar:
        return self.cost.outer(value, theta)

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return self.outer(self.inner(i, t, x, u, theta), theta)


@lru_cache(maxsize=64)
def crosswalk_game(
    players: int = 2, horizon: int = HORIZON, proximity: Proximity = "soft", dt: float = DT
) -> Game:
    """The game; `theta` of each player is `{"goal": (2,)}`.

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
        inequalities = (Inequality(KeepApart(threshold), players - 1, COLLISION_WEIGHT),)
    elif players > 1 and proximity == "hard":
        shared = (SharedInequality(KeepAllApart(threshold), players * (players - 1) // 2),)
    elif players > 1:
        hinge = SquaredDistanceHinge(REFERENCE_DISTANCE, COLLISION_WEIGHT)
        undiscounted = (ReferenceProximity(horizon, hinge),)
    player = Player(
        DoubleIntegrator(dt),
        (Goal(GOAL_WEIGHT), Effort(CONTROL_WEIGHT)),
        undiscounted,
        state_bounds=Bounds.box(
            [-free, -free, -SPEED_LIMIT, -SPEED_LIMIT], [free, free, SPEED_LIMIT, SPEED_LIMIT], 4
        ),
        control_bounds=Bounds.box(-CONTROL_LIMIT, CONTROL_LIMIT, 2),
        inequalities=inequalities,
    )
    return Game((player,) * players, horizon, shared, dt)


class Setting(NamedTuple):
    """Initial states, goals and discount factors of one crossing."""

    initial_states: Float[np.ndarray, "N 4"]
    goals: Float[np.ndarray, "N 2"]
    gamma: Float[np.ndarray, "N"]

    @property
    def theta(self) -> tuple[dict[str, Float[np.ndarray, "2"]], ...]:
        """Parameters for `crosswalk_game`."""
        return tuple({"goal": goal} for goal in self.goals)


MONTE_CARLO = Setting(
    np.array([[2.0, 2.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]]),
    np.array([[0.0, 0.0], [2.0, 0.0]]),
    np.array([0.95, 0.9]),
)
"""The paper's Monte Carlo study."""

HEATMAP = Setting(
    np.array([[0.0, 2.0, 0.1, -0.2], [2.5, 2.0, 0.0, 0.0]]),
    np.array([[2.0, 0.0], [0.0, 0.0]]),
    np.array([0.6, 0.6]),
)
"""The paper's heatmap of the inverse problem's objective."""
