"""The inverse problem as least squares: whitened residuals and their implicit Jacobian.

Minimise `sum_t (h(x_t) - y_t)' Sigma_t^{-1} (h(x_t) - y_t) + prior` (paper, problem 1), where the
trajectory is the equilibrium of the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.newton.implicit import Equilibrium, equilibrium, solution_tangent
from foresight_env.equilibrium.newton.start import Start
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import AnyArray, Scalar
from foresight_env.inverse.coordinates import Coordinates
from foresight_env.inverse.settings import EstimatorSettings


class Data(NamedTuple):
    """Observations and prior."""

    values: Float[AnyArray, "K size"]
    """Observations of `x_1..x_K`; missing entries hold 0."""
    whiten: Float[AnyArray, "K size size"]
    """`Sigma_t^{-1/2}` on the entries that were observed, zero rows for missing ones."""
    prior_mean: Float[AnyArray, "p"]
    prior_root: Float[AnyArray, "q p"]
    """Square root of the prior's information: its cost is `||root (v - mean)||^2`."""
    free: Float[AnyArray, "p"]
    """1 where a parameter is estimated, 0 where it keeps its value."""
    low: Float[AnyArray, "p"]
    """Limits of the parameters; those that are not estimated have none."""
    high: Float[AnyArray, "p"]


@dataclass(frozen=True)
class Problem:
    """Static part of an inverse problem."""

    layout: Layout
    coordinates: Coordinates
    model: ObservationModel
    options: SolverOptions
    settings: EstimatorSettings = EstimatorSettings()


class Fit(NamedTuple):
    """One parameter vector with everything known about it."""

    values: Float[Array, "p"]
    cost: Scalar
    residual: Float[Array, "r"]
    jacobian: Float[Array, "r p"]
    point: Iterate
    rates: Iterate
    """Derivatives of `point` by the parameters, each with a leading axis of p."""
    error: Scalar
    complementarity: Scalar
    success: Bool[Array, ""]
    newton_steps: Int[Array, ""]
    """Of the solve."""


def predicted(
    problem: Problem, initial_state: AnyArray, x: Float[Array, "T n"], count: int
) -> Array:
    """`h(x_1), ..., h(x_count)`."""
    states = jnp.concatenate([initial_state[None], x])[:count]
    return jax.vmap(lambda s: problem.model(problem.layout.split_states(s)))(states)


def residuals(
    problem: Problem, data: Data, values: Array, initial_state: AnyArray, x: Array
) -> Array:
    """Whitened observation errors, then the prior's."""
    errors = predicted(problem, initial_state, x, data.values.shape[0]) - data.values
    seen = jnp.einsum("kij,kj->ki", data.whiten, errors)
    return jnp.concatenate([seen.ravel(), data.prior_root @ (values - data.prior_mean)])


@partial(jax.jit, static_argnums=0, inline=True)
def evaluate_fit(
    problem: Problem,
    data: Data,
    base: Parameters,
    values: Float[Array, "p"],
    start: Start,
) -> Fit:
    """Solve the game at `values` (from `start`) and differentiate the residuals."""
    parameters = problem.coordinates.unpack(values, base)
    result = equilibrium(problem.layout, problem.options, parameters, start)
    residual = residuals(problem, data, values, parameters.initial_state, result.point.x)
    first, rates = solution_jacobian(problem, result, base, values)
    moving = (first, rates.x)
    jacobian = residual_jacobian(
        problem, data, values, parameters.initial_state, result.point.x, moving
    )
    jacobian = jacobian * data.free
    cost = jnp.where(result.success, jnp.sum(residual**2), jnp.inf)
    end = (result.error, result.complementarity, result.success, result.iterations)
    return Fit(values, cost, residual, jacobian, result.point, rates, *end)


def unevaluated(
    problem: Problem, data: Data, base: Parameters, values: Float[Array, "p"], start: Start
) -> Fit:
    """A fit of infinite cost at `start`, from which loops begin."""
    # The shapes are repeated here: `eval_shape` of `evaluate_fit` would trace it a second time.
    point = start.point
    residual = jnp.zeros_like(residuals(problem, data, values, base.initial_state, point.x))
    rates = jax.tree.map(lambda v: jnp.zeros((values.size, *v.shape), v.dtype), point)
    jacobian = jnp.zeros((residual.size, values.size), residual.dtype)
    infinite = jnp.asarray(jnp.inf)
    end = (infinite, infinite, jnp.zeros((), bool), jnp.zeros((), int))
    return Fit(values, infinite, residual, jacobian, point, rates, *end)


def solution_jacobian(
    problem: Problem, result: Equilibrium, base: Parameters, values: Float[AnyArray, "p"]
) -> tuple[Float[Array, "p n"], Iterate]:
    """Derivatives of `x_1` and of all that was solved for, one right-hand side per parameter."""
    layout, options = problem.layout, problem.options

    def along(direction: Array) -> tuple[Array, Iterate]:
        parameters, change = jax.jvp(
            lambda v: problem.coordinates.unpack(v, base), (values,), (direction,)
        )
        return change.initial_state, solution_tangent(layout, options, result, parameters, change)

    return jax.vmap(along)(jnp.eye(values.shape[0]))


def extrapolated(fit: Fit, values: Float[Array, "p"]) -> Iterate:
    """Return the solution at `values` to first order: the start of its solve."""
    step = values - fit.values
    return jax.tree.map(lambda v, r: v + jnp.tensordot(step, r, 1), fit.point, fit.rates)


def continued(start: Start, point: Iterate, solves: Int[Array, ""]) -> Start:
    """Return the next start of a search: warm after the first solve."""
    warm = solves > 0
    warm = warm if start.warm is None else warm | start.warm
    return Start(point, warm, limits=start.limits)


def residual_jacobian(
    problem: Problem,
    data: Data,
    values: Array,
    initial_state: AnyArray,
    x: Array,
    rates: tuple[Array, Array],
) -> Float[Array, "r p"]:
    """Chain rule from trajectories to residuals."""

    def along(direction: Array, initial_change: Array, dx: Array) -> Array:
        return jax.jvp(
            lambda v, a, b: residuals(problem, data, v, a, b),
            (values, initial_state, x),
            (direction, initial_change, dx),
        )[1]

    return jax.vmap(along)(jnp.eye(values.shape[0]), *rates).T
