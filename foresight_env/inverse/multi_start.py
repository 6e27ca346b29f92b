"""Local fits from several starts: the objective has local minima and flat valleys."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.stats import qmc

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.newton.start import Start
from foresight_env.inverse.fit import Data, Fit, Problem, unevaluated
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent


@dataclass(frozen=True)
class MultiStart:
    """Local fits from several starts; the best one is kept.

    The landscape has local minima and flat valleys: from one random start 2 to 5 fits of 8 find the
    best minimum. The first start is the caller's; the others take discount factors from a
    low-discrepancy sequence over `gamma_range` (within that of `Free`), and other parameters from
    the caller and from the best fit before them in turn. Starts are spared once a fit explains the
    observations to within their noise.
    """

    count: int = 8
    gamma_range: tuple[float, float] = (0.3, 1.0)

    def spread(
        self,
        values: Float[np.ndarray, "p"],
        open_gammas: Bool[np.ndarray, "p"],
        limits: tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p"]],
    ) -> Float[np.ndarray, "S p"]:
        """Starting vectors, the caller's first; just that one when no discount factor is free."""
        where = np.flatnonzero(open_gammas)
        if self.count < 2 or where.size == 0:
            return values[None]
        points = qmc.Halton(where.size, scramble=False).random(self.count)[1:]
        least, most = (limit[where] for limit in limits)
        low, high = np.maximum(self.gamma_range[0], least), np.minimum(self.gamma_range[1], most)
        apart = low >= high  # where the two ranges have nothing in common, the limits count
        low, high = np.where(apart, least, low), np.where(apart, most, high)
        starts = np.tile(values, (self.count, 1))
        starts[1:, where] = low + (high - low) * points
        return starts


MOST_STARTS = 16
"""Starts are padded to this many, so that one compiled program serves any number of them. A
limit, not tuned: the default is half of it."""


@compiled(static_argnums=0)
def search(
    problem: Problem,
    method: GaussNewton | GradientDescent,
    data: Data,
    base: Parameters,
    starts: Float[Array, "S p"],
    count: Int[Array, ""],
    begin: Start,
) -> tuple[Fit, Int[Array, ""], Float[Array, "S"]]:
    """The best local fit of up to `count` starts, one after the other.

    In lockstep (`vmap`) every start would wait for the slowest solve of the slowest fit, and none
    could be spared: the search ends once a fit leaves no more unexplained than the noise would
    (its cost, a chi-squared sum, is at most its expectation), or once the best one has been found
    from two starts and is plausible (`SearchSettings`).
    """
    seen = jnp.sum(jnp.any(data.whiten != 0.0, axis=2))
    expected = jnp.maximum(seen - jnp.sum(data.free), 1.0)
    settings = problem.settings.search
    plausible = expected + settings.plausible * jnp.sqrt(2.0 * expected)

    def more(state):
        number, best, _, costs = state
        twice = jnp.sum(costs <= best.cost + settings.same_cost) >= 2
        done = (best.cost <= expected) | (twice & (best.cost <= plausible))
        return (number < count) & ~done

    def one(state):
        number, best, solves, costs = state
        # Every other start begins at the best fit's other parameters: where the caller's initial
        # guess of them is poor, all starts would otherwise fall into the same local minimum.
        fresh = (number % 2 == 1) | (number == 0) | ~jnp.isfinite(best.cost)
        kept = is_gamma | fresh
        values = jnp.where(kept, starts[number], best.values)
        fit, spent = method.run(problem, data, base, values, begin)
        better = fit.cost < best.cost
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), fit, best)
        return number + 1, best, solves + spent, costs.at[number].set(fit.cost)

    is_gamma = jnp.asarray(problem.coordinates.is_gamma)
    nothing = unevaluated(problem, data, base, starts[0], begin)
    zero = jnp.zeros((), int)
    costs = jnp.full(starts.shape[0], jnp.inf)
    _, fit, solves, costs = jax.lax.while_loop(more, one, (zero, nothing, zero, costs))
    return fit, solves, costs
