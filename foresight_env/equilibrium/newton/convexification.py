"""Convexification weight: how much non-convex curvature Newton steps leave out.

Far from a solution, negative curvature of the dynamics (large costates) and of proximity costs
turns a player's step uphill; near one, leaving curvature out slows convergence down.
`Convexification` has the schedule.
"""

from __future__ import annotations

import jax.numpy as jnp

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.settings import Convexification
from foresight_env.games.types import Scalar


def used_weight(
    schedule: Convexification, weight: Scalar, error: Scalar, exact_below: Scalar | float
) -> Scalar:
    """Return the part to leave out, in [0, 1]; 0 where the residual is at most `exact_below`."""
    return jnp.where((error <= exact_below) | (weight < schedule.exact), 0.0, weight)


def next_weight(
    schedule: Convexification,
    layout: Layout,
    weight: Scalar,
    before: Scalar,
    after: Scalar,
    taken: Scalar,
) -> Scalar:
    """Return the weight after a step from one residual to another.

    `taken`: the part of the step up to the first bound. Where all dynamics are linear it stays.
    """
    if layout.linear:
        return weight
    good = (taken > schedule.full) & (after < before)
    bad = (taken < schedule.cut) | (after > schedule.thrown_back * before)
    risen = jnp.minimum(1.0, schedule.rise * jnp.maximum(weight, schedule.restart))
    return jnp.where(good, schedule.fall * weight, jnp.where(bad, risen, weight))
