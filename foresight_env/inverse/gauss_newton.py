"""Projected Levenberg-Marquardt on the whitened residuals: the default inverse method.

Nocedal and Wright, section 10.3, with the damping scaled by the diagonal (Marquardt) and parameters
kept in a box by freezing those that would leave it.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.linear_algebra.small_matrices import inverse
from foresight_env.equilibrium.newton.schedule import limits_of
from foresight_env.equilibrium.newton.start import Start
from foresight_env.equilibrium.settings import Budget
from foresight_env.games.types import Scalar
from foresight_env.inverse.fit import (
    Data,
    Fit,
    Problem,
    continued,
    evaluate_fit,
    extrapolated,
    predicted,
    unevaluated,
)
from foresight_env.inverse.method_tree import register_method
from foresight_env.inverse.tracking_term import TARGET, has_tracking_cost, weighted


@register_method
@dataclass(frozen=True)
class GaussNewton:
    """Settings of the default method: a PyTree, so that one compiled program serves all values."""

    max_iterations: int | Int[Array, ""] = 80
    cost_tolerance: float | Scalar = 1e-4
    """Relative change of the cost, in either direction, that counts as none; after
    `SearchSettings.stalls` such steps the search ends. Where the active set changes the cost has
    kinks, on which steps zigzag: of a chi-squared sum of 200, a ten-thousandth is a seventh of a
    deviation."""
    step_tolerance: float | Scalar = 1e-8
    """Largest change of a parameter below which a step counts as the last one."""
    smoothing: tuple[float | Scalar, ...] = (3e-2, 1e-3)
    """Complementarity products of the games that are fitted first. Their solutions pass smoothly
    from one active set to another, so that steps can be long and fewer local minima are in the
    way; each fit is where the next one begins. Takes at most a quarter of `max_iterations` each;
    left out where the caller has an initial guess."""

    tracking_weights: tuple[float | Scalar, ...] = (100.0, 10.0, 1.0, 0.1, 1e-2, 1e-3)
    """Falling weights of the tracking term (module `tracking_term`) of the games that are fitted
    before all others, to the trajectory that follows the observations; relative to what squared
    controls cost. `()`: none. `benchmarks.synthetic_windows` measures fits with them; left out
    where the caller has an initial guess."""
    initial_cost_limit: float | Scalar = np.inf
    """Cost of the first game above which a search from a caller's guess ends with it."""

    def __post_init__(self) -> None:
        # Tracers are not checked.
        numbers = [b for b in self.smoothing if isinstance(b, Real)]
        if not all(b > 0.0 for b in numbers):
            raise ValueError(f"smoothing: is {self.smoothing}; expected positive numbers")
        weights = [w for w in self.tracking_weights if isinstance(w, Real)]
        if not all(w > 0.0 for w in weights):
            raise ValueError(
                f"tracking_weights: is {self.tracking_weights}; expected positive numbers"
            )

    def run(
        self,
        problem: Problem,
        data: Data,
        base: Parameters,
        values: Float[Array, "p"],
        start: Start,
    ) -> tuple[Fit, Int[Array, ""]]:
        """Improve `values`; returns the best fit and the number of forward solves."""
        low, high, settings = data.low, data.high, problem.settings.search
        tracking = self.tracking_weights if has_tracking_cost(problem.layout) else ()
        smoothest = self.smoothing[:1] or (problem.options.barrier,)
        barriers = jnp.asarray(
            (*smoothest * len(tracking), *self.smoothing, problem.options.barrier)
        )
        last = barriers.size - 1
        weights = jnp.asarray((*tracking, *(0.0,) * (barriers.size - len(tracking))))
        followed = data.values
        if tracking:
            target = jnp.concatenate([own[TARGET] for own in base.theta], axis=1)
            followed = predicted(problem, base.initial_state, target, data.values.shape[0])
        # Fits to the tracked trajectory are an initial guess, and no part of the budget.
        most = self.max_iterations + settings.tracking_solves * len(tracking)
        longest = jnp.maximum(1, self.max_iterations // 4)

        def unfinished(state: _State) -> Bool[Array, ""]:
            final = (state.phase == last) & ~state.renewed
            return ~state.done & ((state.solves <= most) | ~final)

        def body(state: _State) -> _State:
            fit = state.fit
            begin = continued(start, extrapolated(fit, state.trial), state.solves)
            limits = limits_of(Budget.offline()) if start.limits is None else start.limits
            begin = begin._replace(
                barrier=barriers[state.phase], limits=limits.of_trial(~state.renewed)
            )
            game, seen = base, data
            if tracking:
                game = weighted(base, weights[state.phase])
                follows = state.phase < len(tracking)
                seen = data._replace(values=jnp.where(follows, followed, data.values))
            trial = evaluate_fit(problem, seen, game, state.trial, begin)
            # What another game's fit cost is no measure of this one.
            final = state.phase == last
            stiffness = settings.pull * jnp.sum(trial.jacobian**2, axis=0)
            stiffness = jnp.where(state.solves == 0, stiffness, state.stiffness)
            pull = jnp.where(final, 0.0, stiffness)
            cost = trial.cost + jnp.sum(pull * (trial.values - values) ** 2)
            too_costly = final & (state.solves == 0) & (cost > self.initial_cost_limit)
            useless = ~trial.success | too_costly
            better = state.renewed | (trial.success & (cost < state.cost))
            tolerance = jnp.where(final, self.cost_tolerance, settings.smooth_tolerance)
            small = trial.success & (jnp.abs(state.cost - cost) <= tolerance * state.cost)
            stalls = jnp.where(small & ~state.renewed, state.stalls + 1, 0)
            still = jnp.max(jnp.abs(state.trial - fit.values)) <= self.step_tolerance
            over = still | (stalls >= jnp.where(final, settings.stalls, 1))
            over = (over | (~final & (state.steps >= longest))) & ~state.renewed
            too_far = ~trial.success | (cost > settings.too_far * state.cost)
            rise = jnp.where(too_far, settings.rises_much, settings.rises)
            fallen = jnp.maximum(state.damping * settings.falls, settings.least_damping)
            damping = jnp.where(better, fallen, state.damping * rise)
            damping = jnp.where(state.renewed, state.damping, damping)
            chosen = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, fit)
            following = over & ~final
            damping = jnp.where(following, jnp.maximum(damping, settings.phase_damping), damping)
            pull = jnp.where(following & (state.phase + 1 == last), 0.0, pull)
            step = damped_step(
                chosen.values, chosen.residual, chosen.jacobian, damping, data, pull, values
            )
            stepped = jnp.clip(chosen.values + step, low, high)
            return _State(
                chosen,
                jnp.where(better, cost, state.cost),
                stiffness,
                jnp.where(following, chosen.values, stepped),
                damping,
                state.solves + 1,
                jnp.where(following, 0, stalls),
                jnp.where(following, 0, state.steps + 1),
                state.phase + following,
                following,
                jnp.where(state.renewed, useless, over & final),
            )

        values = jnp.clip(values, low, high)
        nothing = unevaluated(problem, data, base, values, start)
        zero, no = jnp.zeros((), int), jnp.zeros((), bool)
        # A solution of a similar game is where smoothing would lead.
        skipped = False if start.warm is None else start.warm
        phase = jnp.where(skipped, last, zero)
        begin = _State(
            nothing,
            nothing.cost,
            jnp.zeros_like(values),
            values,
            jnp.asarray(settings.damping),
            zero,
            zero,
            zero,
            phase,
            ~no,
            no,
        )
        end = jax.lax.while_loop(unfinished, body, begin)
        return end.fit, end.solves


LEAST_SCALE = 1e-6
"""Least information about a parameter, relative to the largest, that damping counts with:
directions that the data say nothing about do not run away. `benchmarks.accuracy`."""
LEAST_RIDGE = 1e-12
"""Least ridge relative to the largest information: a numerical guard, near rounding, that keeps the
normal matrix regular."""


class _State(NamedTuple):
    fit: Fit
    cost: Scalar
    """The fit's, what pulls on the parameters included."""
    stiffness: Float[Array, "p"]
    trial: Float[Array, "p"]
    damping: Scalar
    solves: Int[Array, ""]
    stalls: Int[Array, ""]
    steps: Int[Array, ""]
    """In this phase."""
    phase: Int[Array, ""]
    """Index of the tracking term's weight, then of the complementarity product."""
    renewed: Bool[Array, ""]
    """The trial is the first of its phase: there is no fit yet to compare it with."""
    done: Bool[Array, ""]


def damped_step(
    values: Float[Array, "p"],
    residual: Float[Array, "r"],
    jacobian: Float[Array, "r p"],
    damping: Scalar,
    data: Data,
    pull: Float[Array, "p"],
    center: Float[Array, "p"],
) -> Float[Array, "p"]:
    """Damped Gauss-Newton step on `|residual|^2` and `pull * (values - center)^2`.

    Limits are respected: entries pushed against theirs are frozen.
    """
    low, high = data.low, data.high
    gradient = jacobian.T @ residual + pull * (values - center)
    stuck = ((values <= low) & (gradient > 0)) | ((values >= high) & (gradient < 0))
    free = jnp.where(stuck, 0.0, data.free)
    jacobian = jacobian * free
    normal = jacobian.T @ jacobian + jnp.diag(free * pull)
    scale = jnp.diag(normal)
    largest = jnp.max(scale)
    ridge = damping * (scale + LEAST_SCALE * largest) + LEAST_RIDGE * largest + 1e-300
    # Not LAPACK's: within a loop jaxlib 0.10 fails to compile its calls on machines with one core.
    step = -inverse(normal + jnp.diag(ridge + (1.0 - free))) @ (free * gradient)
    return free * step
