"""How much of the curvature that is not convex Newton steps leave out on the way to a solution.

Far from a solution all of it: what costates, large there, say of bends in the dynamics, and what
proximity costs say of agents in each other's way, would turn a player's step uphill. Near one none
of it, or steps would close in by a constant part only. In between, where dynamics are nonlinear,
neither will do: without it steps creep, with it they throw the iteration back, for ever. So every
full step that comes closer uses a little more of it, and one that was thrown back a lot less
(Levenberg and Marquardt's rule, for another matrix: Nocedal and Wright, section 10.3).
"""

from __future__ import annotations

import jax.numpy as jnp

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.types import Scalar

FALL, RISE = 0.8, 20.0
"""Factors of the convexity after a good and after a bad step."""
FULL, CUT = 0.95, 0.5
"""Parts of a step above which it counts as full, and below which as bad."""
THROWN_BACK = 2.0
"""Factor by which a bad step raises the residual."""
EXACT = 1e-3
"""Convexity below which curvature is used exactly."""


def used_convexity(convexity: Scalar, error: Scalar, exact_below: Scalar | float) -> Scalar:
    """The part to leave out, in [0, 1]; none where the residual is at most `exact_below`."""
    return jnp.where((error <= exact_below) | (convexity < EXACT), 0.0, convexity)


def next_convexity(
    layout: Layout, convexity: Scalar, before: Scalar, after: Scalar, taken: Scalar
) -> Scalar:
    """`convexity` once a step has led from one residual to another.

    `taken`: the part of the step up to the first bound. Where all dynamics are linear it stays.
    """
    if layout.linear:
        return convexity
    good = (taken > FULL) & (after < before)
    bad = (taken < CUT) | (after > THROWN_BACK * before)
    risen = jnp.minimum(1.0, RISE * jnp.maximum(convexity, 2.0 * EXACT))
    return jnp.where(good, FALL * convexity, jnp.where(bad, risen, convexity))
