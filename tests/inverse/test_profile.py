"""Profile likelihood: intervals of discount factors by their definition."""

import sys

import numpy as np
import pytest

from foresight_env.equilibrium import Status, solve
from foresight_env.games import full_state
from foresight_env.inverse import Free, GradientDescent, MultiStart, Prior, Profile, estimate
from foresight_env.inverse.fit import Fit
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_GOALS,
    CROSSING_STATES,
    crossing,
    crossing_theta,
)

DEVIATION = 0.005
module = sys.modules[Profile.__module__]


@pytest.fixture(scope="module")
def noisy():
    true = solve(crossing(), CROSSING_STATES, crossing_theta(CROSSING_GOALS), CROSSING_GAMMA)
    clean = np.concatenate(true.states, axis=1)
    return clean + DEVIATION * np.random.default_rng(5).normal(size=clean.shape)


def fit(seen, gamma=CROSSING_GAMMA, **options):
    options = {"free": Free(), "covariance": DEVIATION**2, "prior": Prior(0.0)} | options
    return estimate(
        crossing(), seen, full_state((4, 4)), initial_state=CROSSING_STATES,
        theta=crossing_theta(CROSSING_GOALS), gamma=gamma, **options,
    )  # fmt: skip


def test_the_objective_rises_by_the_quantile_at_an_intervals_ends(noisy):
    profile = Profile(level=0.68)
    found = fit(noisy, profile=profile)
    assert found.status == Status.SOLVED
    ends = 0
    for player in range(2):
        free = [Free(gamma=i != player) for i in range(2)]
        for end in found.gamma_interval[player]:
            if end in (0.0, 1.0):
                continue
            gamma = found.gamma.copy()
            gamma[player] = end
            held = fit(noisy, gamma, free=free, initial_guess=found.solution, starts=MultiStart(1))
            rise = float(held.cost - found.cost)
            assert 0.6 * profile.rise < rise < 1.4 * profile.rise
            ends += 1
    assert ends >= 2
    assert (found.gamma_interval[:, 0] < found.gamma).all()
    assert (found.gamma < found.gamma_interval[:, 1]).all()


def test_agrees_with_laplace_where_the_problem_is_regular(noisy):
    clean = solve(crossing(), CROSSING_STATES, crossing_theta(CROSSING_GOALS), CROSSING_GAMMA)
    seen, tiny = np.concatenate(clean.states, axis=1), 1e-6
    laplace = fit(seen, covariance=tiny)
    profiled = fit(seen, covariance=tiny, profile=Profile())
    np.testing.assert_allclose(profiled.gamma, laplace.gamma, atol=1e-4)
    np.testing.assert_allclose(
        np.diff(profiled.gamma_interval), np.diff(laplace.gamma_interval), rtol=0.25
    )


def test_a_wider_level_has_wider_intervals_within_the_range(noisy):
    free = Free(gamma_range=(0.2, 0.95))
    narrow, wide = (fit(noisy, free=free, profile=Profile(level=p)) for p in (0.5, 0.99))
    assert (np.diff(narrow.gamma_interval) < np.diff(wide.gamma_interval)).all()
    assert wide.gamma_interval.min() >= 0.2
    assert wide.gamma_interval.max() <= 0.95


def test_a_fixed_discount_factor_has_no_interval(noisy):
    free = (Free(), Free(gamma=False))
    found = fit(noisy, free=free, profile=Profile())
    np.testing.assert_array_equal(found.gamma_interval[1], CROSSING_GAMMA[1])
    assert np.diff(found.gamma_interval[0]) > 0.0


@pytest.mark.parametrize("level", [0.5, 0.99])
@pytest.mark.parametrize("limits", [(0.0, 1.0), (0.4, 0.9)])
def test_what_is_flat_is_open_to_the_ends_of_the_range(level, limits):
    """Far goals: all drive at full throttle, whatever their foresight."""
    far = crossing_theta(np.array([[60.0, 80.0], [-60.0, 80.0]]))
    flat_out = solve(crossing(), CROSSING_STATES, far, CROSSING_GAMMA)
    found = estimate(
        crossing(), np.concatenate(flat_out.states, axis=1), full_state((4, 4)),
        initial_state=CROSSING_STATES, theta=far, gamma=0.6,
        free=Free(theta=(), gamma_range=limits), covariance=1.0, profile=Profile(level),
    )  # fmt: skip
    assert not found.identifiable.any()
    np.testing.assert_array_equal(found.gamma_interval, [limits] * 2)


def test_the_published_method_has_profiles_too(noisy):
    method = GradientDescent(learning_rate=1e-6, max_iterations=5)
    found = fit(noisy, method=method, starts=MultiStart(1), profile=Profile())
    usual = fit(noisy, profile=Profile())
    assert found.cost <= usual.cost + 0.2
    np.testing.assert_allclose(found.gamma_interval, usual.gamma_interval, atol=0.02)


def known(value, cost, solved=True):
    """A fit of one parameter, as far as a walk reads one."""
    return Fit(np.array([value]), np.asarray(cost), *[None] * 6, np.asarray(solved), np.asarray(0))


def walk(cost, limit=1.0, *, at=0.5, points=8, follow=True, solved=lambda g: True):
    """A walk along a profile that is known: `cost` of one parameter, `solved` where games are.

    The Laplace deviation that it begins with is 0.1. Returns whether the center is the best fit,
    the best fit and the end.
    """

    def refit(values, near, held=None, smoothed=False):
        g = float(values[0])
        return known(g, cost(g) if solved(g) else np.inf, solved(g))

    center, covariance = known(at, cost(at)), np.array([[0.01]])
    best, end = module._walk(center, 0, limit, covariance, Profile(points=points), refit, follow)
    return best is center, best, end


@pytest.mark.parametrize("limit", [0.0, 1.0])
@pytest.mark.parametrize("curvature", [5.0, 20.0, 100.0, 3000.0])
def test_a_walk_ends_where_the_profile_has_risen_by_the_quantile(curvature, limit):
    stays, _, end = walk(lambda g: 7.0 + curvature * (g - 0.5) ** 2, limit)
    assert stays
    expected = 0.5 + 2.0 * (limit - 0.5) * min(np.sqrt(Profile().rise / curvature), 0.5)
    np.testing.assert_allclose(end, expected, atol=0.02 * abs(expected - 0.5) + 1e-12)


def test_a_walk_passes_over_a_kink():
    _, _, end = walk(lambda g: 2.0 * max(g - 0.5, 0.0) + 300.0 * max(g - 0.7, 0.0) ** 2)
    exact = np.roots([300.0, 2.0, 0.4 - Profile().rise]).max() + 0.7
    np.testing.assert_allclose(end, exact, atol=0.02)


def test_ends_that_are_not_found_are_those_of_the_range():
    def flat(_):
        return 3.0

    for options in ({"solved": lambda g: g < 0.51}, {"points": 1}):
        assert walk(flat, 0.93, **options)[2] == 0.93
    assert walk(flat, at=1.0)[2] == 1.0
    assert walk(flat, 0.2)[2] == 0.2


def test_a_better_minimum_on_the_way_is_told_unless_told_not_to():
    def two_minima(g):
        return min(50.0 * (g - 0.5) ** 2 + 2.0, 50.0 * (g - 0.8) ** 2)

    stays, best, _ = walk(two_minima)
    assert not stays
    assert best.cost < 1.0
    assert abs(best.values[0] - 0.8) < 0.15
    stays, _, end = walk(two_minima, follow=False)
    assert stays
    assert end == 1.0  # never more than the quantile above the center


@pytest.mark.parametrize(
    ("options", "name"),
    [({"level": 1.0}, "level"), ({"points": 0}, "points"), ({"iterations": 0}, "iterations")],
)
def test_settings_out_of_range_are_named(options, name):
    with pytest.raises(ValueError, match=f"{name}: is"):
        Profile(**options)
