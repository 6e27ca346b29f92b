"""Step rejection: steps that raise the residual far are undone and repeated with damping.

Where linearised constraints nearly contradict each other, Newton steps are so long that nonlinear
dynamics lead anywhere. The damping is added to the controls' curvature and to the softness of
constraint rows (Levenberg and Marquardt; as in filter methods, it is multiplied on every rejection
and falls with success). `Damping` has the numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foresight_env.equilibrium.settings import Damping
from foresight_env.games.types import Scalar


class Damped(NamedTuple):
    """State of the step rejection."""

    value: Float[Array, ""]
    """Damping of the next step; 0 until a step was rejected."""
    reference: Float[Array, ""]
    """Recent largest residual, which falls by half a step."""


def undamped(error: Scalar) -> Damped:
    """Return the state at the beginning of a phase with this residual."""
    return Damped(jnp.zeros(()), error)


def is_rejected(schedule: Damping, damped: Damped, error: Scalar) -> Bool[Array, ""]:
    """Return whether a step to a point with this residual is undone; NaN and infinity are."""
    return ~(error <= schedule.raised * jnp.maximum(damped.reference, schedule.least))


def next_damped(
    schedule: Damping, damped: Damped, before: Scalar, after: Scalar, rejected: Bool[Array, ""]
) -> Damped:
    """Return the state after a step from one residual to another."""
    risen = jnp.maximum(schedule.begin, schedule.rise * damped.value)
    fallen = jnp.where(after < before, schedule.fall * damped.value, damped.value)
    value = jnp.where(
        rejected, risen, jnp.where(fallen < schedule.end * schedule.begin, 0.0, fallen)
    )
    reference = jnp.where(
        rejected, damped.reference, jnp.maximum(after, schedule.memory * damped.reference)
    )
    return Damped(value, reference)
