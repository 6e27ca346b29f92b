"""Linear step of the parameters to new observations, by an earlier fit's derivatives.

As in an extended Kalman filter, but on the whole window: observations and prior are linear in the
change of the parameters, so the step costs no game.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.games.types import AnyArray
from foresight_env.inverse.fit import Data, Problem, residual_jacobian, residuals
from foresight_env.inverse.gauss_newton import damped_step


class Rates(NamedTuple):
    """Derivatives of an earlier fit, moved to the present window, by its f free parameters."""

    states: Float[AnyArray, "stages n f"]
    """Of its joint trajectory."""
    carry: Float[AnyArray, "f f"]
    """Of the parameters of now: initial states are those of the window's first stage, all others
    are the same."""


@compiled(static_argnums=0)
def linear_step(
    problem: Problem,
    data: Data,
    base: Parameters,
    values: Float[Array, "p"],
    point: Iterate,
    states: Float[Array, "stages n p"],
    carry: Float[Array, "p p"],
) -> Float[Array, "p"]:
    """`values` after one damped Gauss-Newton step (Nocedal and Wright, section 10.3).

    `point`: the earlier fit's solution, moved; `states`, `carry`: `Rates`, with zeros and ones for
    parameters that are not estimated.
    """
    moves = jnp.moveaxis(states, 2, 0)
    residual = residuals(problem, data, values, base.initial_state, point.x)
    # The chain rule is linear: in directions of the earlier fit's parameters, that is `carry`.
    plain = residual_jacobian(
        problem, data, values, base.initial_state, point.x, (moves[:, 0], moves[:, 1:])
    )
    seen = residual.size - data.prior_root.shape[0]
    jacobian = jnp.concatenate([plain[:seen], data.prior_root @ carry])
    step = damped_step(
        values,
        residual,
        jacobian,
        jnp.asarray(problem.settings.search.damping),
        data,
        jnp.zeros_like(values),
        values,
    )
    return jnp.clip(values + carry @ step, data.low, data.high)
