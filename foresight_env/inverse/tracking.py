"""Tracking start: a trajectory near the observations, from which equilibria are searched.

A game may have several equilibria (who goes first); the observations say which one was played. The
trajectory that follows them best at little effort is itself the equilibrium of a game in which all
players minimise the same tracking error, so the forward solver finds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.equilibrium.conditions.rollout import next_state, rollout
from foresight_env.equilibrium.linear_algebra.small_matrices import inverse
from foresight_env.equilibrium.newton.implicit import Equilibrium, equilibrium
from foresight_env.equilibrium.newton.start import Start, on_central_path
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.costs import Effort
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import AnyArray, Controls, Scalar, StageNumber, States, Theta
from foresight_env.inverse.fit import Data, Problem
from foresight_env.inverse.settings import TrackingSettings


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


def track(problem: Problem, data: Data, parameters: Parameters) -> Float[Array, "T m"]:
    """Controls of the trajectory from `parameters.initial_state` that follows the observations.

    A car that turns far within a stage has tracking errors with local minima. The tracking game is
    therefore solved twice: from no controls, and from the observed states themselves; the better
    trajectory counts.
    """
    game, settings = problem.layout.game, problem.settings.tracking
    layout = layout_of(tracking_game(game, problem.model))
    count = data.values.shape[0] - 1
    fill = game.horizon - count
    whiten = data.whiten[1:] / jnp.maximum(jnp.max(jnp.abs(data.whiten)), 1e-12)
    theta = {
        "values": jnp.pad(data.values[1:], ((0, fill), (0, 0))),
        "whiten": jnp.pad(whiten, ((0, fill), (0, 0), (0, 0))) * settings.scale,
        "effort": jnp.asarray(settings.effort),
    }
    everyone = len(game.players)
    same = Parameters(parameters.initial_state, (theta,) * everyone, jnp.ones(everyone))
    loose = SolverOptions(tolerance=settings.accuracy, barrier=settings.accuracy)
    none = jnp.zeros((game.horizon, layout.m))
    first = jnp.asarray(parameters.initial_state)

    def error(u: Array) -> Scalar:
        def one(state: Array, seen: Array, root: Array) -> Scalar:
            return jnp.sum((root @ (problem.model(layout.split_states(state)) - seen)) ** 2)

        x = rollout(layout, first, u)
        followed = jnp.sum(jax.vmap(one)(x, theta["values"], theta["whiten"]))
        return followed + settings.effort * jnp.sum(u**2)

    def solve_again(k: Array, best: tuple[Array, Scalar]) -> tuple[Array, Scalar]:
        u, least = best
        x = rollout(layout, first, u)
        seen_x, seen_u = observed_motion(layout, problem.model, settings, first, x, u, theta)
        x, near = jnp.where(k > 0, seen_x, x), jnp.where(k > 0, seen_u, u)
        barrier = jnp.asarray(loose.barrier_schedule)[0]
        start = Start(on_central_path(layout, loose.path, same, x, near, barrier))
        found: Equilibrium = equilibrium(layout, loose, same, start)
        cost = error(found.point.u)
        better = (cost < least) & jnp.isfinite(found.error)
        return jnp.where(better, found.point.u, u), jnp.where(better, cost, least)

    infinite = jnp.asarray(jnp.inf, first.dtype)
    return jax.lax.fori_loop(0, 2, solve_again, (none, infinite))[0]


def observed_motion(
    layout: Layout,
    model: ObservationModel,
    settings: TrackingSettings,
    first: Float[AnyArray, "n"],
    x: Float[Array, "T n"],
    u: Float[Array, "T m"],
    theta: Theta,
) -> tuple[Float[Array, "T n"], Float[Array, "T m"]]:
    """Observed states, those of `x` where not observed, and the controls that lead between them."""
    low, high = (jnp.asarray(b[:, layout.n :]) for b in layout.bounds)

    def observed(state: Array, seen: Array, root: Array) -> Array:
        def error(s: Array) -> Array:
            return root @ (model(layout.split_states(s)) - seen)

        slope = jax.jacfwd(error)(state)
        normal = slope.T @ slope + settings.kept * jnp.eye(layout.n)
        return state - inverse(normal) @ (slope.T @ error(state))

    states = jax.vmap(observed)(x, theta["values"], theta["whiten"])
    before = jnp.concatenate([first[None], states[:-1]])

    def control(t: Array, now: Array, then: Array, old: Array, least: Array, most: Array) -> Array:
        def error(v: Array) -> Array:
            return next_state(layout, t, now, v) - then

        def improve(_: Array, v: Array) -> Array:
            slope = jax.jacfwd(error)(v)
            normal = slope.T @ slope + settings.kept * jnp.eye(layout.m)
            step = inverse(normal) @ (slope.T @ error(v) + settings.kept * (v - old))
            return jnp.clip(v - step, least, most)

        begin = jnp.clip(0.0 * old, least, most)
        return jax.lax.fori_loop(0, settings.inverse_steps, improve, begin)

    stages = jnp.arange(1, layout.game.horizon + 1)
    return states, jax.vmap(control)(stages, before, states, u, low, high)
