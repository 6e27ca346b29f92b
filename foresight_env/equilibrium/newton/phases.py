"""What a solve tries one after the other: how often, with which widths of the path, for how long.

Numbers: 0 are local steps from a similar game's solution, 1 and 2 the path from there, and those
after them the path without it; where there is no such solution, all from 1 on. Module `start` says
where each begins.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.newton.interior_point import SolverOptions
from foresight_env.games.types import AnyArray, Scalar

EXACT_FROM_SOLUTION = 10.0
"""Factor of `SolverOptions.exact_below` on the path from a similar game's solution: curvature there is
much like the solution's."""
ATTEMPTS_NEAR = 2
"""Attempts along the path from a similar game's solution, the second from its controls, nudged,
before it is put aside. Nudged three times, it went on to fail at games that have other solutions;
put aside at once for a cold start, which breaks no symmetry, two walkers who face each other came
to wait for each other, and in the closed loop to collide."""


def step_limit(layout: Layout, options: SolverOptions) -> int:
    """Newton steps that an attempt along the path may take."""
    return options.max_iterations if layout.linear else options.nonlinear_iterations


def attempt_count(options: SolverOptions, near: Bool[AnyArray, ""] | None) -> Int[Array, ""]:
    """Attempts along the path."""
    count = jnp.asarray(len(options.barrier_schedule))
    return count if near is None else count + ATTEMPTS_NEAR * near


def attempt_place(number: Int[Array, ""], near: Bool[AnyArray, ""] | None) -> Int[Array, ""]:
    """Place in `SolverOptions.barrier_schedule`, from 1; counted anew once a solution is put aside."""
    if near is None:
        return number
    return jnp.where(near & (number > ATTEMPTS_NEAR), number - ATTEMPTS_NEAR, number)


def attempt_rules(
    layout: Layout, options: SolverOptions, number: Int[Array, ""], near: Bool[AnyArray, ""] | None
) -> tuple[Scalar, Int[Array, ""]]:
    """Of an attempt along the path: below which residual curvature is exact, and most steps.

    `near`: whether attempt 1 begins at a similar game's solution; None: no attempt does.
    """
    place = attempt_place(number, near)
    exact_below = options.exact_below * 10.0 ** jnp.maximum(place - 1, 0)
    limit = jnp.asarray(step_limit(layout, options))
    if near is None:
        return exact_below, limit
    resumed = near & (number == 1)
    return (
        jnp.where(resumed, EXACT_FROM_SOLUTION * options.exact_below, exact_below),
        jnp.where(resumed, jnp.minimum(limit, options.resumed_steps), limit),
    )
