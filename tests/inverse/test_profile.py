"""Profile likelihood: intervals of discount factors by their definition."""

import numpy as np
import pytest
from small_games import CROSSING_GAMMA, CROSSING_GOALS, CROSSING_STATES, crossing, crossing_theta

from foresight_env.equilibrium import Status, solve
from foresight_env.games import full_state
from foresight_env.inverse import Free, MultiStart, Prior, Profile, estimate

DEVIATION = 0.005


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
            held = fit(noisy, gamma, free=free, guess=found.solution, starts=MultiStart(1))
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


def test_what_is_flat_is_open_to_the_ends_of_the_range(noisy):
    """Far goals: everybody drives flat out, whatever its foresight."""
    far = crossing_theta(np.array([[60.0, 80.0], [-60.0, 80.0]]))
    flat_out = solve(crossing(), CROSSING_STATES, far, CROSSING_GAMMA)
    found = estimate(
        crossing(), np.concatenate(flat_out.states, axis=1), full_state((4, 4)),
        initial_state=CROSSING_STATES, theta=far, gamma=CROSSING_GAMMA,
        free=Free(theta=()), covariance=1.0, profile=Profile(),
    )  # fmt: skip
    assert not found.determined.any()
    np.testing.assert_array_equal(found.gamma_interval, [[0.0, 1.0]] * 2)


@pytest.mark.parametrize(
    ("options", "name"),
    [({"level": 1.0}, "level"), ({"points": 0}, "points"), ({"iterations": 0}, "iterations")],
)
def test_settings_out_of_range_are_named(options, name):
    with pytest.raises(ValueError, match=f"{name}: is"):
        Profile(**options)
