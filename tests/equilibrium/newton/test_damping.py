"""Which steps are rejected, and how the damping rises and falls."""

import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium.newton.damping import Damped, is_rejected, next_damped, undamped
from foresight_env.equilibrium.settings import Damping

SCHEDULE = Damping()


def after(value, reference, before, now, rejected=False):
    damped = Damped(jnp.asarray(value), jnp.asarray(reference))
    found = next_damped(
        SCHEDULE, damped, jnp.asarray(before), jnp.asarray(now), jnp.asarray(rejected)
    )
    return float(found.value), float(found.reference)


@pytest.mark.parametrize(
    ("residual", "rejected"), [(19.0, False), (21.0, True), (np.nan, True), (np.inf, True)]
)
def test_steps_that_raise_the_residual_far_are_rejected(residual, rejected):
    found = is_rejected(SCHEDULE, undamped(jnp.asarray(1.0)), jnp.asarray(residual))
    assert bool(found) == rejected


def test_damping_rises_with_rejections():
    assert after(0.0, 1.0, 1.0, np.nan, True) == (1.0, 1.0)
    assert after(1.0, 1.0, 1.0, 50.0, True) == (10.0, 1.0)


def test_damping_falls_with_success_and_ends():
    assert after(10.0, 1.0, 1.0, 0.9)[0] == pytest.approx(1.0)
    assert after(1.0, 1.0, 1.0, 0.9)[0] == 0.0
    assert after(10.0, 1.0, 1.0, 1.1)[0] == 10.0


def test_steps_are_compared_with_the_recent_largest_residual():
    assert after(0.0, 8.0, 1.0, 0.5)[1] == 4.0
    assert after(0.0, 8.0, 1.0, 6.0)[1] == 6.0


def test_small_residuals_may_be_raised():
    """A phase from a similar game's solution begins with one."""
    started = undamped(jnp.asarray(1e-6))
    assert not is_rejected(SCHEDULE, started, jnp.asarray(10.0))
    assert is_rejected(SCHEDULE, started, jnp.asarray(30.0))
