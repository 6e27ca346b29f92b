"""Projected Levenberg-Marquardt on the whitened residuals: the default inverse method.

Nocedal and Wright, section 10.3, with the damping scaled by the diagonal (Marquardt) and parameters
kept in a box by freezing those that would leave it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.newton.start import Start
from foresight_env.games.types import Scalar
from foresight_env.inverse.fit import (
    Data,
    Fit,
    Problem,
    continued,
    evaluate_fit,
    extrapolated,
    unevaluated,
)
from foresight_env.precision import is_traced

STALLS = 2
"""Steps in a row without a change of the cost after which a search ends."""
SMOOTH_TOLERANCE = 3e-2
"""Relative change of the cost that counts as none while the game is smoothed."""
DAMPING = 0.3
"""Damping of the first step. With less, first steps go so far that the games there take many
iterations to solve, only to be refused."""
PHASE_DAMPING = 1e-2
"""Least damping of the first step after a change of `GaussNewton.smoothing`: the game is less
smooth than the one before."""
PULL = 1e-2
"""How much, beside what the data say of them at the start, parameters are pulled towards their
first values while the game is smoothed. A smoothed game never quite reaches a bound that the
observed agents rest on; without the pull parameters run off in the attempt to get there."""
ASTRAY = 30.0
"""Cost of a step, in multiples of the cost before it, that went much too far."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GaussNewton:
    """Settings of the default method: a PyTree, so that one compiled program serves all values."""

    max_iterations: int | Int[Array, ""] = 80
    cost_tolerance: float | Scalar = 1e-4
    """Relative change of the cost, in either direction, that counts as none; after `STALLS` such
    steps the search ends. Where the active set changes the cost has kinks, on which steps zigzag:
    of a chi-squared sum of 200, a ten-thousandth is a seventh of a deviation."""
    step_tolerance: float | Scalar = 1e-8
    """Largest change of a parameter below which a step counts as the last one."""
    smoothing: tuple[float | Scalar, ...] = (3e-2, 1e-3)
    """Complementarity products of the games that are fitted first. Their solutions pass smoothly
    from one active set to another, so that steps can be long and fewer local minima are in the
    way; each fit is where the next one begins. Takes at most a quarter of `max_iterations` each;
    left out where the caller has an initial guess."""

    give_up: float | Scalar = np.inf
    """Cost of the first game above which a search from a caller's initial guess ends with it."""
    hurried: bool | Bool[Array, ""] = False
    """Whether all games get but the Newton steps of a trial (`SolverOptions.trial_steps`), the first one
    too."""

    def __post_init__(self) -> None:
        if not is_traced(self) and not all(b > 0.0 for b in self.smoothing):
            raise ValueError(f"smoothing: is {self.smoothing}; expected positive numbers")

    def run(
        self,
        problem: Problem,
        data: Data,
        base: Parameters,
        values: Float[Array, "p"],
        start: Start,
    ) -> tuple[Fit, Int[Array, ""]]:
        """Improve `values`; returns the best fit and the number of forward solves."""
        low, high = data.low, data.high
        barriers = jnp.asarray((*self.smoothing, problem.options.barrier))
        longest = jnp.maximum(1, self.max_iterations // 4)

        def unfinished(state: _State) -> Bool[Array, ""]:
            final = (state.phase == len(self.smoothing)) & ~state.renewed
            return ~state.done & ((state.solves <= self.max_iterations) | ~final)

        def body(state: _State) -> _State:
            fit = state.fit
            near = continued(start, extrapolated(fit, state.trial), state.solves)
            near = near._replace(barrier=barriers[state.phase], trial=self.hurried | ~state.renewed)
            trial = evaluate_fit(problem, data, base, state.trial, near)
            # What another game's fit cost is no measure of this one.
            final = state.phase == len(self.smoothing)
            stiffness = PULL * jnp.sum(trial.jacobian**2, axis=0)
            stiffness = jnp.where(state.solves == 0, stiffness, state.stiffness)
            pull = jnp.where(final, 0.0, stiffness)
            cost = trial.cost + jnp.sum(pull * (trial.values - values) ** 2)
            astray_at_once = final & (state.solves == 0) & (cost > self.give_up)
            hopeless = ~trial.success | astray_at_once
            better = state.renewed | (trial.success & (cost < state.cost))
            tolerance = jnp.where(final, self.cost_tolerance, SMOOTH_TOLERANCE)
            small = trial.success & (jnp.abs(state.cost - cost) <= tolerance * state.cost)
            stalls = jnp.where(small & ~state.renewed, state.stalls + 1, 0)
            still = jnp.max(jnp.abs(state.trial - fit.values)) <= self.step_tolerance
            over = still | (stalls >= jnp.where(final, STALLS, 1))
            over = (over | (~final & (state.steps >= longest))) & ~state.renewed
            # Games far away take many iterations: after a step that went much too far, a second
            # one nearly as far is not tried.
            astray = ~trial.success | (cost > ASTRAY * state.cost)
            raised = state.damping * jnp.where(astray, 36.0, 6.0)
            damping = jnp.where(better, jnp.maximum(state.damping * 0.2, 1e-9), raised)
            damping = jnp.where(state.renewed, state.damping, damping)
            chosen = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, fit)
            following = over & ~final
            damping = jnp.where(following, jnp.maximum(damping, PHASE_DAMPING), damping)
            pull = jnp.where(following & (state.phase + 1 == len(self.smoothing)), 0.0, pull)
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
                jnp.where(state.renewed, hopeless, over & final),
            )

        values = jnp.clip(values, low, high)
        nothing = unevaluated(problem, data, base, values, start)
        zero, no = jnp.zeros((), int), jnp.zeros((), bool)
        # A solution of a similar game is where smoothing would lead.
        skipped = False if start.near is None else start.near
        phase = jnp.where(skipped, len(self.smoothing), zero)
        begin = _State(
            nothing,
            nothing.cost,
            jnp.zeros_like(values),
            values,
            jnp.asarray(DAMPING),
            zero,
            zero,
            zero,
            phase,
            ~no,
            no,
        )
        end = jax.lax.while_loop(unfinished, body, begin)
        return end.fit, end.solves


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
    """Index of the complementarity product."""
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
    # A floor keeps directions that the data say nothing about from running away.
    ridge = damping * (scale + 1e-6 * jnp.max(scale)) + 1e-12 * jnp.max(scale) + 1e-300
    step = -jnp.linalg.solve(normal + jnp.diag(ridge + (1.0 - free)), free * gradient)
    return free * step
