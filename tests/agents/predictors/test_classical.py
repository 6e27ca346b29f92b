"""The classical predictors do what their papers define."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agents import History
from agents.egos.predict_then_plan import feared_positions
from agents.interfaces.predictor import Forecast
from agents.predictors.idm import IdmPredictor
from agents.predictors.kalman import KalmanPredictor
from agents.predictors.kinematic import ConstantTurnRateAccelerationPredictor
from agents.predictors.orca import half_plane, nearest_velocity
from agents.predictors.social_force import SocialForcePredictor

DT = 0.2
WALKER, CAR = (0.5, 0.5), (4.0, 2.0)


def seen(rows, kinds, headings=None):
    """A history of these states, (K, N, 4)."""
    states = np.asarray(rows, dtype=float)
    if headings is None:
        headings = np.arctan2(states[..., 3], states[..., 2])
    sizes = [WALKER if kind == "pedestrian" else CAR for kind in kinds]
    return History(states, np.asarray(headings), kinds, np.array(sizes), DT)


def discs(seed):
    """Two discs that do not overlap: from one to the other, velocities, the sum of radii."""
    random = np.random.default_rng(seed)
    radius = random.uniform(0.2, 1.5)
    angle = random.uniform(0.0, 2.0 * np.pi)
    away = random.uniform(1.02, 6.0) * radius * np.array([np.cos(angle), np.sin(angle)])
    return away, random.uniform(-2.0, 2.0, (2, 2)), radius, random


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=200)
def test_velocities_in_both_half_planes_do_not_collide(seed):
    """Van den Berg et al. (2011), section 3: each does half, no two touch within the horizon."""
    away, (own, other), radius, random = discs(seed)
    horizon = random.uniform(0.5, 4.0)
    mine = half_plane(away, own, other, radius, horizon, DT)
    theirs = half_plane(-away, other, own, radius, horizon, DT)
    chosen = nearest_velocity([mine], random.uniform(-2.0, 2.0, 2), 10.0)
    answer = nearest_velocity([theirs], random.uniform(-2.0, 2.0, 2), 10.0)
    times = np.linspace(0.0, horizon, 200)[:, None]
    apart = np.linalg.norm(away + times * (answer - chosen), axis=1)
    assert apart.min() > radius - 1e-6


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=100)
def test_harmless_velocities_are_allowed_and_harmful_ones_are_not(seed):
    """The half-plane has both as they are if and only if they would not collide."""
    away, (own, other), radius, _ = discs(seed)
    point, normal = half_plane(away, own, other, radius, 3.0, DT)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    times = np.linspace(0.0, 3.0, 2000)[:, None]
    least = np.linalg.norm(away + times * (other - own), axis=1).min()
    assume(abs(least - radius) > 1e-2)
    assert ((own - point) @ normal > 0.0) == (least > radius)


def planes_of(seed, count):
    """Random half-planes whose edges pass near the origin."""
    random = np.random.default_rng(seed)
    angles = random.uniform(0.0, 2.0 * np.pi, count)
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return [(random.uniform(-1.0, 1.0) * n, n) for n in normals], random.uniform(-2.0, 2.0, 2)


GRID = np.stack(np.meshgrid(*2 * [np.linspace(-1.5, 1.5, 301)]), axis=-1).reshape(-1, 2)


@given(st.integers(0, 10**6), st.integers(1, 4))
@settings(deadline=None, max_examples=60)
def test_no_allowed_velocity_is_nearer_nor_any_less_broken(seed, count):
    """Against every velocity of a grid, where some are allowed and where none is."""
    planes, wanted = planes_of(seed, count)
    limit = 1.5
    chosen = nearest_velocity(planes, wanted, limit)
    grid = GRID[np.linalg.norm(GRID, axis=1) <= limit]
    inside = np.min([(grid - p) @ n for p, n in planes], axis=0)
    worst = min(float((chosen - p) @ n) for p, n in planes)
    assert np.linalg.norm(chosen) <= limit / np.cos(np.pi / 16) + 1e-6  # the polygon's corners
    if (inside >= 0.0).any():
        assert worst >= -1e-6
        best = np.linalg.norm(grid[inside >= 0.0] - wanted, axis=1).min()
        assert np.linalg.norm(chosen - wanted) <= best + 1e-6
    elif worst < -1e-6:  # a feasible sliver may lie between points of the grid
        assert worst >= inside.max() - 1e-6


def test_social_forces_are_slopes_of_the_potential():
    """Helbing and Molnar (1995), equations 3 and 4, by finite differences."""
    model = SocialForcePredictor()
    other, velocity = np.array([3.0, 0.4]), np.array([-0.5, 0.1])

    def potential(place):
        away, step = place - other, model.stride * velocity
        ellipse = np.linalg.norm(away) + np.linalg.norm(away - step)
        b = 0.5 * np.sqrt(ellipse**2 - step @ step)
        return model.strength * np.exp(-b / model.reach)

    place = np.array([1.4, 0.0])
    ahead, behind = (
        model.push(0, np.stack([place, other]), np.array([[way, 0.0], velocity]), [(0.5, 0.5)] * 2)
        for way in (1.0, -1.0)
    )
    small = 1e-5
    slope = [
        (potential(place + d) - potential(place - d)) / (2.0 * small) for d in small * np.eye(2)
    ]
    np.testing.assert_allclose(ahead, -np.array(slope), rtol=1e-6)
    np.testing.assert_allclose(behind, 0.5 * ahead)  # who looks the other way minds it half


def following(gap, speed, leader_speed, wanted=None, steps=1):
    """A car `gap` metres behind another (bumper to bumper) on a straight lane, and its forecast."""
    times = DT * np.arange(-2, 1)[:, None]
    fast = speed if wanted is None else wanted
    own = np.hstack([times * fast, 0 * times, fast + 0 * times, 0 * times])
    lead = np.hstack([gap + CAR[0] + times * leader_speed, 0 * times, leader_speed + 0 * times])
    history = seen(np.stack([own, np.hstack([lead, 0 * times])], axis=1), ("car", "car"))
    return IdmPredictor().predict(history, steps).most_likely


def test_idm_keeps_its_equilibrium_gap():
    """Treiber et al. (2000), equation 8: the gap at which following costs no acceleration."""
    model = IdmPredictor()
    speed, target = 6.0, 8.0
    gap = (model.standing_gap + speed * model.time_gap) / np.sqrt(1.0 - (speed / target) ** 4)
    assert model._rate(speed, target, (gap, speed)) == pytest.approx(0.0, abs=1e-12)
    assert model._rate(speed, target, (0.9 * gap, speed)) < 0.0
    assert model._rate(speed, target, (1.1 * gap, speed)) > 0.0
    assert model._rate(target, target, None) == pytest.approx(0.0)


@pytest.mark.parametrize("leader_speed", [0.0, 3.0])
def test_idm_does_not_run_into_its_leader(leader_speed):
    path = following(gap=30.0, speed=10.0, leader_speed=leader_speed, steps=60)
    gaps = path[:, 1, 0] - path[:, 0, 0] - CAR[0]
    assert gaps.min() > 1.0
    model = IdmPredictor()
    last = (path[-1, 0, 0] - path[-2, 0, 0]) / DT
    assert last == pytest.approx(leader_speed, abs=0.5)
    assert gaps[-1] == pytest.approx(model.standing_gap + leader_speed * model.time_gap, rel=0.25)


def test_idm_alone_keeps_its_speed():
    path = following(gap=30.0, speed=10.0, leader_speed=100.0, steps=20)
    np.testing.assert_allclose(path[:, 0, 0], 10.0 * DT * np.arange(1, 21), rtol=0.02)


def changing(speed, rate, turn, rows=5):
    """A car whose speed and heading change at these rates, now at the origin along x."""
    times = DT * np.arange(1 - rows, 1)
    speeds, headings = speed + rate * times, turn * times
    states = np.zeros((rows, 1, 4))
    states[:, 0, 2:] = speeds[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    return seen(states, ("car",), headings[:, None])


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize("rate", [-1.5, 0.0, 0.8])
def test_constant_turn_and_acceleration_is_the_integral(rate, turn):
    speed, steps = 4.0, 20
    found = ConstantTurnRateAccelerationPredictor().predict(changing(speed, rate, turn), steps)
    fine = 1e-4
    times = np.arange(fine / 2.0, steps * DT, fine)
    speeds = np.maximum(speed + rate * times, 0.0)
    moved = speeds[:, None] * np.stack([np.cos(turn * times), np.sin(turn * times)], axis=1)
    path = fine * np.cumsum(moved, axis=0)
    ends = np.round(DT * np.arange(1, steps + 1) / fine).astype(int) - 1
    np.testing.assert_allclose(found.most_likely[:, 0], path[ends], atol=1e-3)


def test_a_kalman_filter_without_acceleration_fits_a_line():
    """And without a prior: the estimate of least squares, its variance and its growth."""
    rows, steps, std = 6, 5, 0.05
    random = np.random.default_rng(2)
    states = np.array([1.0, 2.0, 0.5, -0.4]) + std * random.standard_normal((rows, 1, 4))
    states[:, 0, :2] += DT * np.arange(rows)[:, None] * np.array([0.5, -0.4])
    found = KalmanPredictor(noise_std=std, walking=0.0).predict(
        seen(states, ("pedestrian",)), steps
    )
    times = DT * np.arange(1 - rows, 1)
    one, zero = np.ones(rows), np.zeros(rows)
    design = np.vstack([np.column_stack([one, times]), np.column_stack([zero, one])])
    for axis in range(2):
        values = np.concatenate([states[:, 0, axis], states[:, 0, 2 + axis]])
        fitted = np.linalg.lstsq(design, values, rcond=None)[0]
        ahead = np.column_stack([np.ones(steps), DT * np.arange(1, steps + 1)])
        np.testing.assert_allclose(found.most_likely[:, 0, axis], ahead @ fitted, atol=1e-9)
        variance = std**2 * np.linalg.inv(design.T @ design)
        expected = np.einsum("ta,ac,tc->t", ahead, variance, ahead)
        np.testing.assert_allclose(found.covariance[0, :, 0, axis, axis], expected, rtol=1e-8)


def test_white_acceleration_spreads_with_the_cube_of_time():
    """Bar-Shalom et al. (2001), section 6.2.2, after a single observation."""
    model = KalmanPredictor()
    found = model.predict(seen([[[0.0, 0.0, 1.0, 0.0]]], ("pedestrian",)), 8)
    t = DT * np.arange(1, 9)
    expected = model.noise_std**2 * (1.0 + t**2) + model.walking * t**3 / 3.0
    for axis in range(2):
        np.testing.assert_allclose(found.covariance[0, :, 0, axis, axis], expected)


def test_fears_come_nearer_and_never_pass():
    """Deviations along the line to the ego, by hand."""
    positions = np.array([[[0.0, 0.0], [4.0, 3.0], [1.0, 0.0]]])
    covariance = np.zeros((1, 1, 3, 2, 2))
    covariance[0, 0, 1] = np.diag([0.25, 0.0])  # along the line: 0.5 * 4/5
    covariance[0, 0, 2] = 9.0 * np.eye(2)  # more than what is between them
    forecast = Forecast(positions[None], np.ones(1), covariance)
    own = positions[0, :1]
    places = feared_positions(forecast, 0, own, 2.0)
    np.testing.assert_array_equal(places[0, 0], positions[0, 0])
    np.testing.assert_allclose(places[0, 1], [4.0 - 0.8 * 0.8, 3.0 - 0.8 * 0.6])
    np.testing.assert_allclose(places[0, 2], [0.0, 0.0], atol=1e-12)
    certain = Forecast(positions[None], np.ones(1))
    np.testing.assert_array_equal(feared_positions(certain, 0, own, 2.0), positions)
