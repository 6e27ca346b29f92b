"""Metrics of trajectories against values computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import multivariate_normal

from evaluation.metrics.trajectory import (
    LEAST_DEVIATION,
    at_fault,
    best_displacement,
    best_of_agents,
    comfort,
    displacement,
    displacement_until,
    lateral_acceleration,
    log_densities,
    missed,
    negative_log_likelihood,
    trajectory_error,
)

FINITE = st.floats(-1e3, 1e3)


def test_trajectory_error_by_hand():
    states = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert trajectory_error(states, np.array([[1.0, 0.0], [0.0, 4.0]])) == 4.0 + 9.0
    assert trajectory_error(states, states) == 0.0


def test_displacement_by_hand():
    """Agent 0 is 5 m off at the first step and 1 m at the last; agent 1 leaves after the first."""
    truth = np.zeros((2, 2, 2))
    predicted = np.array([[[3.0, 4.0], [0.0, 2.0]], [[1.0, 0.0], [9.0, 9.0]]])
    present = np.array([[True, True], [True, False]])
    truth[1, 1] = np.nan  # not observed there, so nothing to compare with
    average, final = displacement(predicted, truth, present)
    assert average == pytest.approx((5.0 + 2.0 + 1.0) / 3.0)
    assert final == pytest.approx((1.0 + 2.0) / 2.0)


def test_displacement_until_by_hand():
    """Off by 1, 2, 3 m after 0.4, 0.8, 1.2 s."""
    truth = np.zeros((3, 1, 2))
    predicted = np.array([[[1.0, 0.0]], [[2.0, 0.0]], [[3.0, 0.0]]])
    present = np.ones((3, 1), bool)
    assert displacement_until(predicted, truth, present, 0.4, 0.8) == pytest.approx((1.5, 2.0))
    assert displacement_until(predicted, truth, present, 0.4, 1.0) == pytest.approx((1.5, 2.5))
    assert displacement_until(predicted, truth, present, 0.4, 1.2) == pytest.approx((2.0, 3.0))
    average, final = displacement_until(predicted, truth, present, 0.4, 1.4)
    assert average == pytest.approx(2.0)
    assert np.isnan(final)
    present[1:] = False  # it leaves: nothing to compare with between the steps
    average, final = displacement_until(predicted, truth, present, 0.4, 1.0)
    assert average == pytest.approx(1.0)
    assert np.isnan(final)
    assert np.isnan(displacement_until(predicted, truth, present, 0.4, 0.2)).all()


def test_missed_by_hand():
    truth = np.zeros((2, 4, 2))
    predicted = np.zeros((2, 4, 2))
    predicted[:, 1:, 0] = 2.1
    predicted[1, 0, 0] = 1.9
    present = np.array([[True, True, True, False], [True, True, False, False]])
    truth[~present] = np.nan
    assert missed(predicted, truth, present).tolist() == [False, True, True, False]


def test_likelihood_by_hand():
    """One Gaussian, then the same twice with half the probability each, then one far away."""
    positions, truth = np.zeros((1, 1, 1, 2)), np.array([[[3.0, 4.0]]])
    wide = np.full((1, 1, 1, 2, 2), 0.0) + (4.0 - LEAST_DEVIATION**2) * np.eye(2)
    here = np.ones((1, 1), bool)
    wanted = 25.0 / (2.0 * 4.0) + np.log(2.0 * np.pi * 4.0)
    found = negative_log_likelihood(positions, np.ones(1), wide, truth, here)
    assert found == pytest.approx(wanted)
    twice = np.repeat(positions, 2, axis=0), np.full(2, 0.5), np.repeat(wide, 2, axis=0)
    assert negative_log_likelihood(*twice, truth, here) == pytest.approx(wanted)
    twice[0][1] = 1e3
    far = negative_log_likelihood(*twice, truth, here)
    assert far == pytest.approx(wanted + np.log(2.0))
    certain = np.array([1.0, 0.0])  # a future without probability counts for nothing
    assert negative_log_likelihood(twice[0], certain, twice[2], truth, here) == pytest.approx(
        wanted
    )


def test_likelihood_prefers_the_covariance_that_errors_have():
    random = np.random.default_rng(0)
    truth, present = random.normal(0.0, 0.5, (400, 1, 2)), np.ones((400, 1), bool)
    found = {}
    for deviation in (0.25, 0.5, 1.0):
        covariance = np.full((1, 400, 1, 2, 2), 0.0) + deviation**2 * np.eye(2)
        found[deviation] = negative_log_likelihood(
            np.zeros((1, 400, 1, 2)), np.ones(1), covariance, truth, present
        )
    assert min(found, key=found.__getitem__) == 0.5


def test_best_displacement_by_hand():
    """The third future is right, but only two of the most_likely count."""
    truth, present = np.zeros((2, 1, 2)), np.ones((2, 1), bool)
    positions = np.stack([np.full((2, 1, 2), x) for x in (1.0, 2.0, 0.0)])
    chances = np.array([0.5, 0.3, 0.2])
    assert best_displacement(positions, chances, truth, present, 1) == pytest.approx([2**0.5] * 2)
    assert best_displacement(positions, chances, truth, present, 2) == pytest.approx([2**0.5] * 2)
    assert best_displacement(positions, chances, truth, present, 3) == (0.0, 0.0)
    assert best_displacement(positions, chances[::-1], truth, present, 1) == (0.0, 0.0)


def test_who_is_at_fault():
    ego, ahead, far = [0.0, 0.0, 5.0, np.pi / 2], [0.5, 4.0, 0.0, 0.0], [-9.0, 0.0, 9.0, 0.0]
    assert at_fault(np.array([ego, ahead, far]), 0)
    assert not at_fault(np.array([ahead, ego, far]), 0)  # who stands
    behind = [0.0, -4.0, 9.0, np.pi / 2]
    assert not at_fault(np.array([ego, behind, far]), 0)
    assert at_fault(np.array([behind, ego, far]), 0)


def test_comfort_of_even_motions():
    times = 0.1 * np.arange(20)
    zeros = np.zeros(20)
    braking = np.stack([zeros, zeros, 8.0 - 2.0 * times, zeros], axis=1)
    np.testing.assert_allclose(comfort(braking, 0.1), (2.0, 0.0, 0.0), atol=1e-9)
    circling = np.stack([zeros, zeros, zeros + 5.0, 0.3 * times], axis=1)
    np.testing.assert_allclose(comfort(circling, 0.1), (0.0, 0.0, 1.5), atol=1e-9)
    assert np.isnan(comfort(circling[:2], 0.1)).all()


def test_nobody_present():
    nothing = displacement(np.zeros((2, 1, 2)), np.zeros((2, 1, 2)), np.zeros((2, 1), bool))
    assert np.isnan(nothing).all()


@given(
    arrays(float, (4, 2, 2), elements=FINITE),
    arrays(bool, (4, 2)),
    st.floats(0.0, 10.0),
    st.floats(0.0, 2.0 * np.pi),
)
def test_a_constant_error_is_its_own_average(truth, present, size, angle):
    shifted = truth + size * np.array([np.cos(angle), np.sin(angle)])
    average, final = displacement(shifted, truth, present)
    if present.any():
        assert average == pytest.approx(size, abs=1e-9)
        assert final == pytest.approx(size, abs=1e-9)
        # An absent agent does not count, wherever it is predicted.
        elsewhere = np.where(present[..., None], shifted, 1e9)
        assert displacement(elsewhere, truth, present) == (average, final)
    else:
        assert np.isnan([average, final]).all()


@given(arrays(float, (3, 4), elements=FINITE), arrays(float, (3, 4), elements=FINITE))
def test_trajectory_error_is_symmetric_and_scales(one, other):
    error = trajectory_error(one, other)
    assert error == trajectory_error(other, one)
    assert error >= 0.0
    assert trajectory_error(2.0 * one, 2.0 * other) == pytest.approx(4.0 * error)


def test_lateral_acceleration_on_a_circle():
    """v^2 / r, to second order in the step; 0 on a line and where an agent stands."""
    radius, speed, dt = 20.0, 5.0, 0.1
    angles = speed * dt / radius * np.arange(1, 30)
    circle = radius * np.stack([np.sin(angles), 1.0 - np.cos(angles)], axis=1)
    found = lateral_acceleration(circle, np.zeros(2), dt)
    assert found == pytest.approx(speed**2 / radius, rel=1e-3)
    line = np.arange(1.0, 9.0)[:, None] * np.array([0.3, 0.4])
    assert lateral_acceleration(line, np.zeros(2), dt) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(lateral_acceleration(circle[:1], np.zeros(2), dt))  # no two steps
    trembling = 1e-3 * np.random.default_rng(0).standard_normal((8, 2))
    assert lateral_acceleration(trembling, np.zeros(2), dt) == 0.0
    circle[20:] = np.nan  # it has left
    assert lateral_acceleration(circle, np.zeros(2), dt) == pytest.approx(found)


def test_the_best_future_of_each_agent_and_metric():
    """Agent 0: one future is right on average, another at the end; agent 1 is right in the last."""
    truth = np.zeros((2, 2, 2))
    futures = np.full((4, 2, 2, 2), 9.0)
    futures[0, :, 0] = [[0.0, 0.0], [2.0, 0.0]]
    futures[1, :, 0] = [[0.0, 6.0], [0.0, 1.0]]
    futures[3, :, 1] = 0.0
    chances = np.array([0.4, 0.3, 0.2, 0.1])
    best = best_of_agents(futures, chances, truth, 4)
    np.testing.assert_allclose(best.average, [1.0, 0.0])
    np.testing.assert_allclose(best.final, [1.0, 0.0])
    # The least likely future does not count among three.
    np.testing.assert_allclose(best_of_agents(futures, chances, truth, 3).final[1], 9.0 * 2**0.5)


def test_densities_of_a_mixture():
    random = np.random.default_rng(0)
    positions, places = random.normal(size=(2, 3, 1, 2)), random.normal(size=(4, 3, 1, 2))
    root = random.normal(size=(2, 3, 1, 2, 2))
    covariance, chances = root @ root.swapaxes(-1, -2), np.array([0.3, 0.7])
    found = log_densities(positions, chances, covariance, places)
    for s in range(4):
        for k in range(3):
            expected = sum(
                p * multivariate_normal(m, c + LEAST_DEVIATION**2 * np.eye(2)).pdf(places[s, k, 0])
                for p, m, c in zip(chances, positions[:, k, 0], covariance[:, k, 0], strict=True)
            )
            assert found[s, k, 0] == pytest.approx(np.log(expected))
