"""Predictors: from a history of observed agents to a forecast; NumPy arrays only.

A user's own model plugs in by having a `name` and a `predict` method; nothing is inherited.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from foresight_env.envs.core.scene import Population
from foresight_env.games.game import Game
from foresight_env.games.kinds import check_kinds_of_agents


@dataclass(frozen=True, eq=False)
class SceneGame:
    """Game that the agents of a history play, as far as any observer may know it.

    It has no agent's own parameters, not even the observer's, which other predictors do not know.
    """

    game: Game
    """Over the agents' planning horizon; its players are the agents of the history, in order."""
    population: Population
    """Prior of their parameters."""
    noise_std: float
    """Standard deviation of every observed coordinate, m and m/s."""


@dataclass(frozen=True, eq=False)
class Context:
    """Information about the place in addition to the tracks; predictors may ignore it."""

    routes: tuple[Float[np.ndarray, "_ _"], ...] = ()
    """Centre lines of vehicles' routes: (M, 4) points `[px, py, heading, curvature]`, 1 m apart (m,
    rad, 1/m). Where there is no map they are learned from earlier traffic."""
    frequencies: Float[np.ndarray, "R"] = field(default_factory=lambda: np.zeros(0))
    """How many vehicles took each route."""
    game: SceneGame | None = None
    """In simulated places the game that is played there; None in recordings."""

    def __post_init__(self) -> None:
        if self.frequencies.shape != (len(self.routes),):
            raise ValueError(
                f"frequencies: has shape {self.frequencies.shape}; expected one per route, "
                f"({len(self.routes)},)"
            )
        for k, route in enumerate(self.routes):
            if route.ndim != 2 or route.shape[1] != 4 or len(route) < 2:
                raise ValueError(
                    f"routes[{k}]: has shape {route.shape}; expected (M, 4) with at least 2 points"
                )


@dataclass(frozen=True, eq=False)
class History:
    """Observed states of N agents at K steps, the last of them now."""

    states: Float[np.ndarray, "K N 4"]
    """`[px, py, vx, vy]` (m, m/s), NaN where an agent was not seen."""
    headings: Float[np.ndarray, "K N"]
    """rad; NaN where the recording has none, as of pedestrians."""
    kinds: tuple[str, ...]
    """"pedestrian", "bicycle", or a vehicle's kind."""
    extents: Float[np.ndarray, "N 2"]
    """Lengths and widths, m; NaN where the recording states none."""
    dt: float
    """Seconds per step."""
    context: Context = Context()

    def __post_init__(self) -> None:
        count = len(self.kinds)
        steps = len(self.states)
        for name, shape in (
            ("states", (steps, count, 4)),
            ("headings", (steps, count)),
            ("extents", (count, 2)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"{name}: has shape {getattr(self, name).shape}; expected {shape} for {count} "
                    "kinds"
                )
        if not (math.isfinite(self.dt) and self.dt > 0.0):
            raise ValueError(f"dt: is {self.dt}; expected a positive number of seconds")
        check_kinds_of_agents(self.kinds)
        unseen = np.flatnonzero(np.isnan(self.states).any(axis=2).all(axis=0))
        if unseen.size:
            raise ValueError(f"states: agent {unseen[0]} was never seen; leave it out")

    def seen(self, agent: int) -> np.ndarray:
        """Rows in which the agent was seen, at least one."""
        return np.flatnonzero(~np.isnan(self.states[:, agent]).any(axis=1))


@dataclass(frozen=True, eq=False)
class Forecast:
    """M possible futures of N agents over P steps, the first one step from now."""

    positions: Float[np.ndarray, "M P N 2"]
    """m."""
    probabilities: Float[np.ndarray, "M"]
    covariance: Float[np.ndarray, "M P N 2 2"] | None = None
    """Of the positions, m^2, where the predictor has it."""
    gamma: Float[np.ndarray, "N"] | None = None
    """Discount factors that the prediction rests on: per step, of `junction-game` per second."""
    gamma_deviation: Float[np.ndarray, "N"] | None = None
    """Standard deviations; 0 where one rests on a limit of the search, or was not inferred."""
    gamma_identifiable: Bool[np.ndarray, "N"] | None = None
    """False where the observations do not identify a discount factor."""
    fallback: bool = False
    """Whether the predictor failed and this is a simpler predictor's forecast."""

    @property
    def most_likely(self) -> Float[np.ndarray, "P N 2"]:
        """Positions of the future of highest probability."""
        return np.asarray(self.positions[int(np.argmax(self.probabilities))])


def single(positions: Float[np.ndarray, "P N 2"]) -> Forecast:
    """A forecast of one future."""
    return Forecast(positions[None], np.ones(1))


@runtime_checkable
class Predictor(Protocol):
    """Predictor of agents' positions."""

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        ...

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast of the next `steps` steps of `history.dt`."""
        ...


@dataclass(frozen=True)
class FunctionPredictor:
    """A plain function as a predictor."""

    function: Callable[[History, int], Forecast | Float[np.ndarray, "P N 2"]]
    """From a history and a number of steps: positions (m), or a whole forecast."""
    name: str

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the function's forecast."""
        found = self.function(history, steps)
        return found if isinstance(found, Forecast) else single(np.asarray(found, dtype=float))
