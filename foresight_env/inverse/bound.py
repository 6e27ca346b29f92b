"""The Cramer-Rao bound: smallest covariance of any unbiased estimator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.compilation import compiled
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.implicit import equilibrium
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.equilibrium.status import SolveError, Status
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.coordinates import Coordinates, Free
from foresight_env.inverse.fit import Problem, predicted, solution_jacobian
from foresight_env.inverse.parameter import Parameter
from foresight_env.precision import to_numpy

BLIND = 1e-12
"""Information relative to the largest at or below which a direction counts as unobserved: rounding
of an eigenvalue. A numerical guard, as the next two."""
LEAK = 1e-6
"""Part of the trajectory's derivatives in unobserved directions above which its bound is infinite:
the square root of `BLIND`."""
OPEN = 1e-9
"""Squared component of a parameter in unobserved directions above which its bound is infinite."""


class CramerRao(NamedTuple):
    """Bounds at the true parameters for noise of variance 1 on every observed entry."""

    covariance: Float[np.ndarray, "p p"]
    """Of the free parameters; multiply by the noise variance. Where the observations leave a
    parameter open, its variance is infinite and its covariances are 0."""
    trajectory: Float[np.ndarray, ""]
    """Of the trajectory error `E||X_hat - X||^2` over all stages and state entries."""
    parameters: tuple[Parameter, ...]
    """The p free parameters."""


@compiled(static_argnums=(0, 1))
def _jacobians(
    problem: Problem, count: int, parameters: Parameters
) -> tuple[Array, Array, Array, Array]:
    values = problem.coordinates.pack(parameters)
    start = begin(problem.layout, problem.options, parameters, None)
    result = equilibrium(problem.layout, problem.options, parameters, start)
    first, rest = solution_jacobian(problem, result, parameters, values)

    def along(initial_change: Array, dx: Array) -> Array:
        return jax.jvp(
            lambda a, b: predicted(problem, a, b, count),
            (parameters.initial_state, result.point.x),
            (initial_change, dx),
        )[1].ravel()

    seen = jax.vmap(along)(first, rest.x)
    states = jnp.concatenate([first[:, None], rest.x], axis=1)
    return seen.T, states.reshape(states.shape[0], -1).T, result.success, result.error


def cramer_rao(
    game: Game,
    model: ObservationModel,
    *,
    initial_state: Any,
    theta: Sequence[Theta],
    gamma: Any,
    free: Free | Sequence[Free] = Free(),
    count: int | None = None,
    options: SolverOptions = SolverOptions(),
) -> CramerRao:
    """Return the Cramer-Rao bound, from the exact Jacobian of the equilibrium.

    Noise is independent and of variance 1 on every entry: multiply by the variance of yours.
    Directions that the observations do not touch do not count in `trajectory` unless the trajectory
    itself depends on them; it is then infinite.

    Args:
        game: the game that is played.
        model: the observation model `h`.
        initial_state: per-player `x_1`, true.
        theta: per-player parameters, true.
        gamma: discount factors, true.
        free: parameters that an estimator would not know, for all players or per player.
        count: number of observations `h(x_1), ..., h(x_count)`; None: all T + 1.
        options: settings of the forward solver.

    Returns:
        A `CramerRao` with the covariance (p, p) of the free parameters and their names.

    Raises:
        ValueError: an argument is wrong, or nothing is free.
        SolveError: the game is not solved.
    """
    layout = layout_of(game)
    parameters = check_parameters(game, initial_state, theta, gamma, "initial_state")
    coordinates, chosen = Coordinates.of(layout, free, parameters)
    if not chosen.any():
        raise ValueError("free: nothing is free; there is nothing to bound")
    stages = game.horizon + 1
    if count is not None and not 1 <= count <= stages:
        raise ValueError(f"count: is {count}; expected 1 to {stages}, the game's stages")
    problem = Problem(layout, coordinates, model, options)
    with jax.enable_x64(True):
        seen, states, success, error = to_numpy(_jacobians(problem, count or stages, parameters))
    if not success:
        raise SolveError(Status.ITERATION_LIMIT, float(error))
    seen, states = seen[:, chosen], states[:, chosen]
    spectrum, basis = np.linalg.eigh(seen.T @ seen)
    blind = spectrum <= BLIND * spectrum[-1]
    inverse = np.where(blind, 0.0, 1.0 / np.where(blind, 1.0, spectrum))
    covariance = (basis * inverse) @ basis.T
    leak = np.linalg.norm(states @ basis[:, blind]) > LEAK * np.linalg.norm(states)
    trajectory = np.inf if leak else float(np.trace(states @ covariance @ states.T))
    open_ = np.sum(basis[:, blind] ** 2, axis=1) > OPEN
    covariance[open_] = 0.0
    covariance[:, open_] = 0.0
    covariance[open_, open_] = np.inf
    each = zip(coordinates.parameters, chosen, strict=True)
    estimated = tuple(parameter for parameter, is_free in each if is_free)
    return CramerRao(covariance, np.asarray(trajectory), estimated)
