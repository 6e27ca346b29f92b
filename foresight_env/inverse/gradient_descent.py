"""The paper's Algorithm 1: projected gradient descent with a fixed learning rate."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.newton.start import Start
from foresight_env.games.types import Scalar
from foresight_env.inverse.fit import (
    Data,
    Fit,
    Problem,
    continued,
    evaluate_fit,
    unevaluated,
)
from foresight_env.inverse.method_tree import register_method


@register_method
@dataclass(frozen=True)
class GradientDescent:
    """Algorithm 1, with its hyper-parameters `K` and tolerance as published; a PyTree."""

    learning_rate: float | Scalar
    """`alpha`, in units of parameter per unit of gradient of the objective."""
    max_iterations: int | Int[Array, ""] = 500
    tolerance: float | Scalar = 1e-4
    """Stop when the parameter vector moves by less than this (2-norm)."""

    def run(
        self,
        problem: Problem,
        data: Data,
        base: Parameters,
        values: Float[Array, "p"],
        start: Start,
    ) -> tuple[Fit, Int[Array, ""]]:
        """Descend from `values`; returns the last fit and the number of forward solves."""
        low, high = data.low, data.high
        values = jnp.clip(values, low, high)

        def unfinished(state):
            _, _, count, moved = state
            return (moved > self.tolerance) & (count <= self.max_iterations)

        def body(state):
            fit, values, count, _ = state
            near = continued(start, fit.point, count)
            trial = evaluate_fit(problem, data, base, values, near)
            chosen = jax.tree.map(lambda new, old: jnp.where(trial.success, new, old), trial, fit)
            gradient = 2.0 * trial.jacobian.T @ trial.residual
            following = jnp.clip(values - self.learning_rate * gradient, low, high)
            moved = jnp.where(trial.success, jnp.linalg.norm(following - values), 0.0)
            return chosen, following, count + 1, moved

        nothing = unevaluated(problem, data, base, values, start)
        begin = (nothing, values, jnp.zeros((), int), jnp.asarray(jnp.inf))
        fit, _, count, _ = jax.lax.while_loop(unfinished, body, begin)
        return fit, count
