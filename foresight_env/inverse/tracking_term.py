"""Tracking term: games whose equilibria stay near the observed trajectory.

A game may have many equilibria, and the one that a solver finds at poor parameters is seldom the
one that was observed. At first, every player therefore also pays for leaving the trajectory that
follows the observations (module `tracking`). With a large weight that trajectory *is* the
equilibrium, whatever the parameters, and a fit chooses the parameters that violate the players'
first-order conditions least; as the weight falls, the equilibrium changes continuously. Compare
Ramsay, Hooker, Campbell and Cao, "Parameter estimation for differential equations: a generalized
smoothing approach", J. R. Statist. Soc. B 69, 2007.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.stage import stage_cost
from foresight_env.games.types import AnyArray, Controls, Scalar, StageNumber, States, Theta

WEIGHT = "weight of the tracking term"
TARGET = "target of the tracking term"
PRECISION = "precision of the tracking term"


@dataclass(frozen=True)
class TrackingTerm(PermutationInvariant):
    """`weight * sum_k precision_tk (x_tk - target_tk)^2`, of the player's own state."""

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        error = x[i] - theta[TARGET][t - 1]
        return theta[WEIGHT] * jnp.sum(theta[PRECISION][t - 1] * error**2)


@lru_cache(maxsize=64)
def with_tracking_cost(game: Game) -> Game:
    """Return the game with a tracking term among every player's costs."""
    players = tuple(replace(p, costs=(*p.costs, TrackingTerm())) for p in game.players)
    return replace(game, players=players)


def has_tracking_cost(layout: Layout) -> bool:
    """Whether the players of a layout have a tracking term."""
    return any(isinstance(cost, TrackingTerm) for cost in layout.game.players[0].costs)


def with_tracking(
    layout: Layout,
    parameters: Parameters,
    target: Float[AnyArray, "T n"],
    precision: Float[AnyArray, "T n"],
) -> Parameters:
    """Return the parameters of the game with a tracking term, whose weight is 0."""
    theta = tuple(
        {
            **own,
            WEIGHT: jnp.zeros(()),
            TARGET: jnp.asarray(target)[:, columns],
            PRECISION: jnp.asarray(precision)[:, columns],
        }
        for own, columns in zip(parameters.theta, layout.state_slices, strict=True)
    )
    return parameters._replace(theta=theta)


def weighted(parameters: Parameters, weight: Scalar) -> Parameters:
    """Return the parameters with this weight of the tracking term."""
    return parameters._replace(theta=tuple({**own, WEIGHT: weight} for own in parameters.theta))


def without_tracking(theta: tuple[Theta, ...]) -> tuple[Theta, ...]:
    """Return the players' parameters as those of the game without a tracking term."""
    added = (WEIGHT, TARGET, PRECISION)
    return tuple({name: value for name, value in t.items() if name not in added} for t in theta)


def tracking_precision(
    layout: Layout,
    model: ObservationModel,
    whiten: Float[AnyArray, "K size size"],
    parameters: Parameters,
    point: Iterate,
) -> Float[Array, "T n"]:
    """Precisions of state entries in the tracking term.

    The information of the observations about an entry, at most 1, times the curvature of the
    owner's costs by its controls (half the mean second derivative): weights of the term then mean
    the same in games of all scales.
    """
    count = whiten.shape[0] - 1

    def information(state: Array, root: Array) -> Array:
        slope = root @ jax.jacfwd(lambda s: model(layout.split_states(s)))(state)
        return jnp.sum(slope**2, axis=0)

    seen = jax.vmap(information)(point.x[:count], jnp.asarray(whiten)[1:])
    seen = seen / jnp.maximum(jnp.max(seen), 1e-300)
    seen = jnp.pad(seen, ((0, point.x.shape[0] - count), (0, 0)))
    players = range(len(parameters.theta))
    price = jnp.stack([control_curvature(layout, i, parameters, point) for i in players])
    return seen * price[layout.state_owner]


def control_curvature(layout: Layout, i: int, parameters: Parameters, point: Iterate) -> Scalar:
    """Half the mean second derivative of player i's stage costs by its own controls."""
    theta = parameters.theta[i]
    size = layout.game.control_sizes[i]

    def curvature(t: Array, x: Array, u: Array) -> Array:
        states, controls = layout.split_states(x), layout.split_controls(u)

        def cost(own: Array) -> Scalar:
            used = (*controls[:i], own, *controls[i + 1 :])
            return stage_cost(layout.game, i, t, states, used, theta)[0]

        return jnp.trace(jax.hessian(cost)(controls[i])) / (2.0 * size)

    stages = jnp.arange(1, layout.game.horizon + 1)
    return jnp.mean(jax.vmap(curvature)(stages, point.x, point.u))
