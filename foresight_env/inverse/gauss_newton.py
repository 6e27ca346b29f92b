"""Projected Levenberg-Marquardt on the whitened residuals: the default inverse method.

Nocedal and Wright, section 10.3, with the damping scaled by the diagonal (Marquardt) and parameters
kept in a box by freezing those that would leave it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.kkt import Parameters
from foresight_env.equilibrium.start import Start
from foresight_env.games.types import AnyArray, Scalar
from foresight_env.inverse.fit import (
    Data,
    Fit,
    Problem,
    continued,
    evaluate_fit,
    extrapolated,
    limits,
    unevaluated,
)

STALLS = 2
"""Steps in a row without a change of the cost after which a search ends."""
DAMPING = 0.3
"""Damping of the first step. With less, first steps go so far that the games there take many
iterations to solve, only to be refused."""


@dataclass(frozen=True)
class GaussNewton:
    """Settings of the default method."""

    max_iterations: int = 80
    cost_tolerance: float = 1e-4
    """Relative change of the cost, in either direction, that counts as none; after `STALLS` such
    steps the search ends. Where the active set changes the cost has kinks, on which steps zigzag:
    of a chi-squared sum of 200, a ten-thousandth is a seventh of a deviation."""
    step_tolerance: float = 1e-8
    """Largest change of a parameter below which a step counts as the last one."""

    def run(
        self,
        problem: Problem,
        data: Data,
        base: Parameters,
        values: Float[Array, "p"],
        start: Start,
    ) -> tuple[Fit, Int[Array, ""]]:
        """Improve `values`; returns the best fit and the number of forward solves."""
        low, high = limits(problem, data)

        def unfinished(state: _State) -> Bool[Array, ""]:
            return ~state.done & (state.solves <= self.max_iterations)

        def body(state: _State) -> _State:
            fit = state.fit
            near = continued(start, extrapolated(fit, state.trial), state.solves)
            trial = evaluate_fit(problem, data, base, state.trial, near)
            better = trial.success & (trial.cost < fit.cost)
            gain = fit.cost - trial.cost
            still = jnp.max(jnp.abs(state.trial - fit.values)) <= self.step_tolerance
            small = trial.success & (jnp.abs(gain) <= self.cost_tolerance * fit.cost)
            stalls = jnp.where(small, state.stalls + 1, 0)
            finished = still | (stalls >= STALLS)
            first = state.solves == 0
            finished = jnp.where(first, ~trial.success, finished)
            damping = jnp.where(better, jnp.maximum(state.damping * 0.2, 1e-9), state.damping * 6.0)
            damping = jnp.where(first, state.damping, damping)
            chosen = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, fit)
            step = damped_step(chosen, damping, low, high, data.free)
            trial_values = jnp.clip(chosen.values + step, low, high)
            return _State(chosen, trial_values, damping, state.solves + 1, stalls, finished)

        values = jnp.clip(values, low, high)
        nothing = unevaluated(problem, data, base, values, start)
        zero = jnp.zeros((), int)
        begin = _State(nothing, values, jnp.asarray(DAMPING), zero, zero, jnp.zeros((), bool))
        end = jax.lax.while_loop(unfinished, body, begin)
        return end.fit, end.solves


class _State(NamedTuple):
    fit: Fit
    trial: Float[Array, "p"]
    damping: Scalar
    solves: Int[Array, ""]
    stalls: Int[Array, ""]
    done: Bool[Array, ""]


def damped_step(
    fit: Fit, damping: Scalar, low: Array, high: Array, free: AnyArray
) -> Float[Array, "p"]:
    """Damped Gauss-Newton step; entries pushed against their limit are frozen."""
    gradient = fit.jacobian.T @ fit.residual
    stuck = ((fit.values <= low) & (gradient > 0)) | ((fit.values >= high) & (gradient < 0))
    free = jnp.where(stuck, 0.0, free)
    jacobian = fit.jacobian * free
    normal = jacobian.T @ jacobian
    scale = jnp.diag(normal)
    # A floor keeps directions that the data say nothing about from running away.
    ridge = damping * (scale + 1e-6 * jnp.max(scale)) + 1e-12 * jnp.max(scale) + 1e-300
    step = -jnp.linalg.solve(normal + jnp.diag(ridge + (1.0 - free)), free * gradient)
    return free * step
