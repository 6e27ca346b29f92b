"""Evasive manoeuvres against the dynamics that they stand for."""

import jax.numpy as jnp
import numpy as np
import pytest

from agents.egos.car_paths import along, covered_distance, is_on, path_ahead, pursuit, swerved
from agents.egos.manoeuvres import velocities, walk
from foresight_env.games import DoubleIntegrator, KinematicBicycle, SlipBicycle

DT = 0.1
LIMIT = np.array([10.0, 6.0])


def test_a_walker_that_changes_its_velocity_moves_as_the_double_integrator():
    state, targets = np.array([0.3, -0.2, 0.5, -0.4]), np.array([[0.0, 0.0], [-0.8, 0.8]])
    times = DT * np.arange(1, 8)
    controls, poses = walk(state, targets, LIMIT, times, DT)
    for target, control, found in zip(targets, controls, poses, strict=True):
        assert (np.abs(control) <= LIMIT + 1e-12).all()
        # Small steps, each with the acceleration that is still needed.
        fine, now, places = DoubleIntegrator(1e-3), state, []
        ramp = np.maximum(np.abs(target - state[2:]) / LIMIT, DT)
        for k in range(700):
            active = 1e-3 * k < ramp - 1e-9
            now = np.asarray(fine(1, jnp.array(now), jnp.array(np.where(active, control, 0.0))))
            if (k + 1) % 100 == 0:
                places.append(now[:2])
        np.testing.assert_allclose(found[:, :2], places, atol=2e-3)
        np.testing.assert_allclose(now[2:], target, atol=1e-2)


def test_velocities_of_evasion_lie_on_the_limits():
    low, high = np.array([-0.8, -0.5]), np.array([0.8, 0.3])
    found = velocities(low, high)
    assert (found >= low - 1e-12).all()
    assert (found <= high + 1e-12).all()
    touching = np.isclose(found, low) | np.isclose(found, high)
    assert not found[0].any()
    assert touching[1:].any(axis=1).all()
    assert np.isfinite(velocities(np.full(2, -np.inf), np.full(2, np.inf))).all()


@pytest.mark.parametrize("acceleration", [-5.0, -1.0, 0.0, 2.0])
def test_covered_distance_is_the_integral_of_the_speed(acceleration):
    times = np.linspace(0.05, 4.0, 80)
    found = covered_distance(6.0, np.array([acceleration]), 9.0, times)[0]
    grid = np.linspace(0.0, 4.0, 40_001)
    speed = np.clip(6.0 + acceleration * grid, 0.0, 9.0)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(grid))])
    np.testing.assert_allclose(found, np.interp(times, grid, integral), atol=1e-6)


def test_a_car_without_a_speed_limit_only_accelerates():
    found = covered_distance(5.0, np.array([-1.0, 0.0, 2.0]), np.inf, np.array([1.0, 2.0]))
    np.testing.assert_allclose(found, [[4.5, 8.0], [5.0, 10.0], [6.0, 14.0]])


def circle(radius=20.0, points=60):
    angle = np.arange(points) * 2.0 / radius
    places = radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    return np.column_stack([places, angle])


def test_a_path_leads_through_the_plan_and_then_along_the_route():
    route = circle()
    planned = route[1:4, :2] + [0.0, 0.5]
    path = path_ahead(np.array([0.0, 0.5, 0.0]), planned, route)
    assert np.isclose(path[1:4, 1:3], planned).all()
    # Parallel to the route, at the offset of the plan's end.
    centre = np.array([0.0, 20.0])
    distances = np.linalg.norm(path[4:20, 1:3] - centre, axis=1)
    np.testing.assert_allclose(distances, np.linalg.norm(planned[-1] - centre), atol=0.05)
    # Its headings are those of its pieces.
    steps = np.diff(path[:20, 1:3], axis=0)
    np.testing.assert_allclose(path[1:20, 3], np.arctan2(*steps.T[::-1]), atol=1e-9)


def test_a_swerve_ends_beside_the_path_and_heads_where_it_moves():
    path = path_ahead(np.array([1.0, 2.0, 0.3]), np.zeros((0, 2)), None)
    swerve = swerved(path, 1.5, 5.0, 12.0)
    poses = along(swerve, np.linspace(0.0, 30.0, 3001)[None])[0]
    direction, left = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    ahead = (poses[:, :2] - [1.0, 2.0]) @ direction
    offset = (poses[:, :2] - [1.0, 2.0]) @ left
    assert np.allclose(offset[ahead <= 5.0], 0.0, atol=1e-9)
    assert np.allclose(offset[ahead >= 17.0], 1.5)
    steps = np.diff(poses[:, :2], axis=0)
    middle = 0.5 * (poses[1:, 2] + poses[:-1, 2])
    # Straight between its points, which are a metre apart.
    np.testing.assert_allclose(np.arctan2(*steps.T[::-1]), middle, atol=0.03)


def test_poses_on_a_path_and_off_it():
    path = path_ahead(np.array([1.0, 2.0, 0.3]), np.zeros((0, 2)), None)
    here = np.array([*along(path, np.array([[7.3]]))[0, 0, :2], 0.3])
    left = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    assert is_on(path, here)
    assert is_on(path, here + np.array([0.0, 0.0, 2.0 * np.pi]))
    assert is_on(path, here + 0.2 * left)
    assert not is_on(path, here + 0.3 * left)
    assert not is_on(path, here + np.array([0.0, 0.0, 0.2]))


@pytest.mark.parametrize("dynamics", [SlipBicycle(0.02), KinematicBicycle(0.02, 2.7)], ids=repr)
@pytest.mark.parametrize("target", [(8.0, 1.0), (8.0, -2.0), (10.0, 0.0)])
def test_pursuit_steers_to_the_place(dynamics, target):
    state = np.array([3.0, -1.0, 5.0, 0.4])
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    place = state[:2] + turn @ target
    steering = pursuit(dynamics, state, place, (-0.6, 0.6))
    nearest = np.inf
    for _ in range(200):
        state = np.asarray(dynamics(1, jnp.array(state), jnp.array([0.0, steering])))
        nearest = min(nearest, float(np.linalg.norm(state[:2] - place)))
    assert nearest < 0.1
