"""Tracking start: a trajectory near the observations, from which equilibria are searched.

A game may have several equilibria (who goes first); the observations say which one was played. The
trajectory that follows them best at little effort is itself the equilibrium of a game in which all
players minimise the same tracking error, so the forward solver finds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.implicit import Equilibrium, equilibrium
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.costs import Effort
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta
from foresight_env.inverse.fit import Data, Problem


@dataclass(frozen=True)
class _TrackingError:
    model: ObservationModel

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        error = theta["whiten"][t - 1] @ (self.model(x) - theta["values"][t - 1])
        return jnp.sum(error**2)


@lru_cache(maxsize=64)
def tracking_game(game: Game, model: ObservationModel) -> Game:
    """Game in which all players follow the observations, with bounds but no constraints."""
    players = tuple(
        replace(
            p,
            costs=(_TrackingError(model), Effort("effort")),
            undiscounted_costs=(),
            inequalities=(),
            equalities=(),
        )
        for p in game.players
    )
    return Game(players, game.horizon, (), game.dt)


EFFORT = 0.1
"""Price of a squared control unit relative to a squared standard deviation of tracking error."""


def track(problem: Problem, data: Data, parameters: Parameters) -> Float[Array, "T m"]:
    """Controls of the trajectory from `parameters.initial_state` that follows the observations."""
    game = problem.layout.game
    layout = layout_of(tracking_game(game, problem.model))
    count = data.values.shape[0] - 1
    fill = game.horizon - count
    # The least certain observation sets the scale, so that small noise does not demand jerks.
    whiten = data.whiten[1:] / jnp.maximum(jnp.max(jnp.abs(data.whiten)), 1e-12)
    theta = {
        "values": jnp.pad(data.values[1:], ((0, fill), (0, 0))),
        "whiten": jnp.pad(whiten, ((0, fill), (0, 0), (0, 0))) * 10.0,
        "effort": jnp.asarray(EFFORT),
    }
    everyone = len(game.players)
    same = Parameters(parameters.initial_state, (theta,) * everyone, jnp.ones(everyone))
    loose = SolverOptions(tolerance=1e-4, barrier=1e-4)
    start = begin(layout, loose, same, None)
    found: Equilibrium = equilibrium(layout, loose, same, start)
    usable = jnp.isfinite(found.error)
    return jnp.where(usable, found.point.u, jnp.zeros((game.horizon, layout.m)))
