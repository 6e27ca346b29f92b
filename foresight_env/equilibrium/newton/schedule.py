"""Restart schedule of the forward solver: phases, their barrier values and iteration limits.

Phase 0 is the semismooth one from a similar game's solution; then come `warm_phases` interior-point
phases from there, and the interior-point phases of `barrier_schedule` without it. Without such a
solution phases count from 1. Module `start` has where each begins.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.settings import UNLIMITED, Budget, SolverOptions
from foresight_env.games.types import AnyArray, Scalar


class Limits(NamedTuple):
    """The part of a `Budget` that a compiled program reads at run time."""

    phases: Int[AnyArray, ""]
    """Most interior-point phases."""
    newton_steps: Int[AnyArray, ""]
    """Most Newton steps of each."""
    trial_newton_steps: Int[AnyArray, ""]
    """The same of a fit's trial steps, which have one phase."""

    def of_trial(self, trial: Bool[AnyArray, ""]) -> Limits:
        """Return the limits of a solve that may be a fit's trial step."""
        phases = jnp.where(trial, 1, self.phases)
        most = jnp.minimum(self.trial_newton_steps, self.newton_steps)
        steps = jnp.where(trial, most, self.newton_steps)
        return self._replace(phases=phases, newton_steps=steps)


def limits_of(budget: Budget) -> Limits:
    """Return a budget's numbers, those that it leaves open as `UNLIMITED`."""
    numbers = (budget.phases, budget.newton_steps, budget.trial_newton_steps)
    # In NumPy: a solve hands them over in microseconds.
    return Limits(*(np.asarray(UNLIMITED if n is None else n) for n in numbers))


class PhaseRules(NamedTuple):
    """How one phase iterates."""

    exact_below: Scalar | float
    """Residual below which all curvature is used exactly."""
    steps: Int[Array, ""]
    """Most Newton steps."""
    semismooth: Bool[Array, ""] | None
    """Whether it is the semismooth phase; None: the program has none."""


def phase_count(
    options: SolverOptions, warm: Bool[AnyArray, ""] | None, limits: Limits | None
) -> Int[Array, ""]:
    """Return the number of the last phase; `warm`: whether the start solves a similar game."""
    count = jnp.asarray(len(options.barrier_schedule))
    if warm is not None:
        count = count + options.warm_phases * warm
    return count if limits is None else jnp.minimum(count, limits.phases)


def schedule_place(
    options: SolverOptions, number: Int[Array, ""], warm: Bool[AnyArray, ""] | None
) -> Int[Array, ""]:
    """Return the place in `barrier_schedule`, from 1, of a phase with this number."""
    if warm is None:
        return number
    discarded = warm & (number > options.warm_phases)
    return jnp.where(discarded, number - options.warm_phases, number)


def phase_rules(
    layout: Layout,
    options: SolverOptions,
    number: Int[Array, ""],
    warm: Bool[AnyArray, ""] | None,
    limits: Limits | None,
) -> PhaseRules:
    """Return the rules of the phase with this number."""
    place = schedule_place(options, number, warm)
    exact_below = options.exact_below * options.exact_growth ** jnp.maximum(place - 1, 0)
    steps = jnp.asarray(options.linear_steps if layout.linear else options.nonlinear_steps)
    if warm is not None:
        resumed = warm & (number == 1)
        exact_below = jnp.where(resumed, options.warm_exactness * options.exact_below, exact_below)
        steps = jnp.where(resumed, jnp.minimum(steps, options.warm_steps), steps)
    if limits is not None:
        steps = jnp.minimum(steps, limits.newton_steps)
    if warm is None:
        return PhaseRules(exact_below, steps, None)
    semismooth = number == 0
    steps = jnp.where(semismooth, options.semismooth_steps, steps)
    return PhaseRules(jnp.where(semismooth, jnp.inf, exact_below), steps, semismooth)
