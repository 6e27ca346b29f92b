"""Small games that many tests share; the same object each time, so that it is compiled once."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from foresight_env.equilibrium import SolverOptions
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    KinematicBicycle,
    MinimumDistance,
    Player,
    SharedInequality,
    SharedMinimumDistance,
    SquaredDistanceHinge,
)

TIGHT = SolverOptions(tolerance=1e-11)


@dataclass(frozen=True)
class Linear:
    """`x' = a x + b u` with any sizes."""

    a: tuple[tuple[float, ...], ...]
    b: tuple[tuple[float, ...], ...]
    linear: bool = True

    @staticmethod
    def of(a: Any, b: Any) -> "Linear":
        return Linear(tuple(map(tuple, np.asarray(a))), tuple(map(tuple, np.asarray(b))))

    @property
    def state_size(self) -> int:
        return len(self.a)

    @property
    def control_size(self) -> int:
        return len(self.b[0])

    def __call__(self, t, state, control):
        return jnp.asarray(self.a) @ state + jnp.asarray(self.b) @ control


@dataclass(frozen=True)
class Quadratic:
    """`w' Q_t w / 2 + c_t' w` of the whole joint stage vector, both from `theta`."""

    def __call__(self, i, t, x, u, theta):
        w = jnp.concatenate([*x, *u])
        return 0.5 * w @ theta["Q"][t - 1] @ w + theta["c"][t - 1] @ w


CROSSING_STATES = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 1.1, 0.1, 0.0]])
CROSSING_GOALS = np.array([[0.0, 0.0], [1.0, 0.1]])
CROSSING_GAMMA = np.array([0.9, 0.7])


@lru_cache
def crossing(proximity: str = "soft", horizon: int = 8, multiplier: str = "individual") -> Game:
    """Two point masses that cross within the horizon: bounds on speed and acceleration."""
    inequalities, undiscounted, shared = (), (), ()
    if proximity == "soft":
        inequalities = (Inequality(MinimumDistance("closest"), 1, "price"),)
    elif proximity == "hard":
        shared = (SharedInequality(SharedMinimumDistance(0.6), 1, multiplier),)
    else:
        undiscounted = (SquaredDistanceHinge("closest", "price"),)
    player = Player(
        DoubleIntegrator(0.2),
        (Goal("goal_weight"), Effort(0.1)),
        undiscounted,
        state_bounds=Bounds.box([-np.inf, -np.inf, -0.9, -0.9], [np.inf, np.inf, 0.9, 0.9], 4),
        control_bounds=Bounds.box(-2.0, 2.0, 2),
        inequalities=inequalities,
        extra_theta=("closest", "price"),  # of the game with a shared constraint
    )
    return Game((player, player), horizon, shared, 0.2)


def crossing_theta(goals: Any = CROSSING_GOALS, price: Any = 2.0) -> tuple[dict[str, Any], ...]:
    return tuple(
        {"goal": goals[i], "goal_weight": 1.0, "closest": 0.9, "price": price} for i in range(2)
    )


@lru_cache
def unequal_sizes() -> Game:
    """A bicycle that meets a walker who sets its velocity: sizes (4, 2) and (2, 2)."""
    car = Player(
        KinematicBicycle(0.2, 1.0),
        (Goal(), Effort(0.1), SquaredDistanceHinge(1.0, 2.0)),
        control_bounds=Bounds.box([-2.0, -0.5], [2.0, 0.5], 2),
    )
    walker = Player(
        Linear.of(np.eye(2), 0.2 * np.eye(2)), (Goal(), Effort(), SquaredDistanceHinge(1.0, 2.0))
    )
    return Game((car, walker), 8, (), 0.2)


UNEQUAL_STATES = (np.array([0.0, 0.2, 1.0, 0.1]), np.array([1.2, -0.4]))
UNEQUAL_THETA = ({"goal": np.array([2.0, 0.6])}, {"goal": np.array([1.0, 1.0])})
