"""Levels of highest-density regions, by hand and on data drawn from the forecasts."""

import numpy as np
import pytest

from evaluation.metrics.calibration import BINS, coverage, density_levels, level_counts
from evaluation.metrics.trajectory import LEAST_DEVIATION

ONE = np.ones(1)


def covariances(modes, steps, agents, deviation):
    """Isotropic, so that those of the density, with the least deviation added, have `deviation`."""
    own = deviation**2 - LEAST_DEVIATION**2
    return np.broadcast_to(own * np.eye(2), (modes, steps, agents, 2, 2))


def test_one_gaussian_by_hand():
    """The level at distance d is 1 - exp(-d^2 / 2): 0 in the middle, 0.5 at d^2 = 2 log 2."""
    positions = np.zeros((1, 3, 1, 2))
    away = 2.0 * np.array([0.0, np.sqrt(2.0 * np.log(2.0)), 10.0])
    truth = np.stack([away, 0.0 * away], axis=1)[:, None]
    levels = density_levels(positions, ONE, covariances(1, 3, 1, 2.0), truth)
    np.testing.assert_allclose(levels[:, 0], [0.0, 0.5, 1.0], atol=1e-9)


def test_a_mixture_agrees_with_its_only_mode():
    """A second mode without probability changes the estimate by sampling error alone."""
    random = np.random.default_rng(0)
    truth = random.normal(size=(40, 2, 2))
    wide = covariances(2, 40, 2, 1.0)
    positions = np.zeros((2, 40, 2, 2))
    exact = density_levels(positions[:1], ONE, wide[:1], truth)
    drawn = density_levels(positions, np.array([1.0, 0.0]), wide, truth)
    np.testing.assert_allclose(drawn, exact, atol=0.1)


@pytest.mark.parametrize(
    "probabilities", [np.ones(1), np.array([0.7, 0.3]), np.array([0.2, 0.5, 0.3])]
)
def test_coverage_of_data_drawn_from_the_forecast(probabilities):
    """4000 positions: standard errors of 0.008 and 0.005."""
    random = np.random.default_rng(1)
    modes, steps, agents = len(probabilities), 500, 8
    positions = 3.0 * random.normal(size=(modes, steps, agents, 2))
    root = random.normal(size=(modes, steps, agents, 2, 2)) + 2.0 * np.eye(2)
    covariance = root @ root.swapaxes(-1, -2)
    wide = covariance + LEAST_DEVIATION**2 * np.eye(2)
    mode = random.choice(modes, (steps, agents), p=probabilities)
    k, a = np.meshgrid(range(steps), range(agents), indexing="ij")
    truth = positions[mode, k, a] + np.einsum(
        "kaij,kaj->kai",
        np.linalg.cholesky(wide[mode, k, a]),
        random.standard_normal((steps, agents, 2)),
    )
    present = np.ones((steps, agents), bool)
    curve = coverage([level_counts(positions, probabilities, covariance, truth, present)])
    assert curve[BINS // 2 - 1] == pytest.approx(0.5, abs=0.03)
    assert curve[18 - 1] == pytest.approx(0.9, abs=0.02)
    # A forecast that is half as wide as it should be covers less.
    narrow = level_counts(positions, probabilities, 0.25 * covariance, truth, present)
    assert coverage([narrow])[BINS // 2 - 1] < 0.4


def test_absent_agents_are_not_counted():
    truth = np.full((2, 2, 2), np.nan)
    truth[0, 1] = 0.0
    present = ~np.isnan(truth[..., 0])
    counts = level_counts(np.zeros((1, 2, 2, 2)), ONE, covariances(1, 2, 2, 1.0), truth, present)
    assert counts == [1] + [0] * (BINS - 1)
    np.testing.assert_array_equal(coverage([counts, counts]), np.ones(BINS))
