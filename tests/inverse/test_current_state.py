"""The present state: a fit corrected by the newest observation."""

import numpy as np
import pytest

from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.games import full_state, positions
from foresight_env.inverse.current_state import corrected
from foresight_env.scenarios.crosswalk import crosswalk_game

LAYOUT = layout_of(crosswalk_game(2, 5))
FULL, POSITIONS = full_state((4, 4)), positions((4, 4))
VARIANCE = 0.01


def drawn(seed=0):
    """A state and a covariance."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(8, 8))
    return random.normal(size=8), 0.1 * root @ root.T, random


def test_a_fit_that_explains_everything_stays():
    state, _, random = drawn()
    found = corrected(LAYOUT, FULL, state, np.zeros((8, 8)), random.normal(size=8), VARIANCE)
    assert [s.shape for s in found] == [(4,), (4,)]
    np.testing.assert_array_equal(np.concatenate(found), state)


def test_a_fit_that_explains_nothing_gives_way():
    state, _, random = drawn()
    seen = random.normal(size=8)
    found = corrected(LAYOUT, FULL, state, 1e6 * np.eye(8), seen, VARIANCE)
    np.testing.assert_allclose(np.concatenate(found), seen, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_mean_of_the_gaussian_given_the_observation(seed):
    """In information form, which the code does not use; entries that are missing say nothing."""
    state, covariance, random = drawn(seed)
    seen = random.normal(size=4)
    seen[1] = np.nan
    rates = np.eye(8)[[0, 4, 5]]  # of the positions, what was observed
    information = np.linalg.inv(covariance)
    expected = np.linalg.solve(
        information + rates.T @ rates / VARIANCE,
        information @ state + rates.T @ seen[[0, 2, 3]] / VARIANCE,
    )
    found = corrected(LAYOUT, POSITIONS, state, covariance, seen, VARIANCE)
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=1e-8, atol=1e-8)


def test_nothing_seen_changes_nothing():
    state, covariance, _ = drawn()
    found = corrected(LAYOUT, FULL, state, covariance, np.full(8, np.nan), VARIANCE)
    np.testing.assert_array_equal(np.concatenate(found), state)
