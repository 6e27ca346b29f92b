"""Motion models against their closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from foresight_env.games import (
    CurvatureVehicle,
    DoubleIntegrator,
    Dynamics,
    KinematicBicycle,
    SmoothVehicle,
)
from foresight_env.games.arc import arc

numbers = st.floats(-5.0, 5.0, width=32)


def vectors(size):
    return st.lists(numbers, min_size=size, max_size=size).map(np.array)


def moved(dynamics, state, control):
    with jax.enable_x64(True):
        return np.asarray(dynamics(1, jnp.asarray(state), jnp.asarray(control)))


@settings(deadline=None, max_examples=30)
@given(vectors(4), vectors(2), st.sampled_from([0.05, 0.1, 0.24, 1.0]))
def test_double_integrator_is_the_exact_zero_order_hold(state, control, dt):
    # d/dt [x, u] = M [x, u]: the matrix exponential holds u constant over dt.
    continuous = np.zeros((6, 6))
    continuous[:2, 2:4] = np.eye(2)
    continuous[2:4, 4:] = np.eye(2)
    expected = expm(continuous * dt) @ np.concatenate([state, control])
    np.testing.assert_allclose(
        moved(DoubleIntegrator(dt), state, control), expected[:4], atol=1e-12
    )


@settings(deadline=None, max_examples=30)
@given(vectors(4), st.floats(-1.2, 1.2), numbers, st.sampled_from([0.7, 1.0, 2.7]))
def test_bicycle_is_one_euler_step_of_the_paper(state, steering, acceleration, wheelbase):
    px, py, speed, heading = state
    dt = 0.1
    expected = [
        px + dt * speed * np.cos(heading),
        py + dt * speed * np.sin(heading),
        speed + dt * acceleration,
        heading + dt * speed * np.tan(steering) / wheelbase,
    ]
    actual = moved(KinematicBicycle(dt, wheelbase), state, np.array([acceleration, steering]))
    np.testing.assert_allclose(actual, expected, atol=1e-12)


def test_a_vehicle_of_constant_curvature_stays_on_its_circle():
    """To second order: with half the step, a quarter of the error (here of 0.4 s at 8 m/s)."""
    curvature, speed, seconds = 0.1, 8.0, 1.6
    exact = arc(np.array([speed, 0.0]), speed * curvature, np.array([seconds]))[0]
    errors = []
    for steps in (4, 8, 16):
        state = np.array([0.0, 0.0, speed, 0.0])
        for _ in range(steps):
            state = moved(CurvatureVehicle(seconds / steps), state, np.array([0.0, curvature]))
        assert state[3] == pytest.approx(seconds * speed * curvature)
        errors.append(np.linalg.norm(state[:2] - exact))
    assert errors[0] < 0.06
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.05)


def test_a_smooth_vehicle_integrates_its_jerk():
    """Speed and acceleration exactly; places to second order, of a car that steers and brakes."""
    state, control = np.array([0.0, 0.0, 8.0, 0.2, -1.0, 0.02]), np.array([0.5, 0.01])
    after = moved(SmoothVehicle(0.4), state, control)
    assert after[2] == pytest.approx(8.0 - 1.0 * 0.4 + 0.5 * 0.5 * 0.4**2)
    assert after[4:] == pytest.approx([-0.8, 0.024])

    def rate(_, s):
        speed, heading, acceleration, curvature = s[2:]
        moving = [speed * np.cos(heading), speed * np.sin(heading)]
        return [*moving, acceleration, speed * curvature, *control]

    exact = solve_ivp(rate, (0.0, 1.6), state, rtol=1e-10, atol=1e-12).y[:, -1]
    errors = []
    for steps in (4, 8, 16):
        now = state
        for _ in range(steps):
            now = moved(SmoothVehicle(1.6 / steps), now, control)
        errors.append(np.linalg.norm(now - exact))
    assert errors[0] < 0.05
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.1)


def test_arcs_by_hand():
    quarter = arc(np.array([1.0, 0.0]), np.pi / 2.0, np.array([0.0, 1.0, 2.0]))
    radius = 2.0 / np.pi
    np.testing.assert_allclose(quarter, [[0, 0], [radius, radius], [0, 2 * radius]], atol=1e-12)
    straight = arc(np.array([1.0, 2.0]), 0.0, np.array([3.0]))
    np.testing.assert_allclose(straight, [[3.0, 6.0]])


@pytest.mark.parametrize(
    "dynamics",
    [DoubleIntegrator(0.1), KinematicBicycle(0.1), CurvatureVehicle(0.1), SmoothVehicle(0.1)],
)
def test_linear_is_what_it_says(dynamics):
    """`linear` lets solvers skip second derivatives: they must vanish, and only then."""
    with jax.enable_x64(True):
        size = dynamics.state_size
        point = jnp.array([0.3, -0.2, 1.1, 0.4, 0.5, 0.2, 0.1, 0.6])[: size + 2]
        second = jax.jacfwd(jax.jacfwd(lambda v: dynamics(1, v[:size], v[size:])))(point)
    assert isinstance(dynamics, Dynamics)
    assert (np.asarray(second) == 0.0).all() == dynamics.linear
