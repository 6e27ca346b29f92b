"""Posterior means and their parts, by cases in which they are known."""

import numpy as np
import pytest
from scipy.stats import binom, norm, truncnorm

from foresight_env.equilibrium import Status, solve
from foresight_env.games import full_state
from foresight_env.games.costs import Effort, Goal
from foresight_env.games.discounting import Exponential, ExponentialPerSecond
from foresight_env.games.dynamics import DoubleIntegrator
from foresight_env.games.game import Game, Player
from foresight_env.inverse import Free, MultiStart, Posterior, Prior, Profile, estimate
from foresight_env.inverse.foresight_prior import LONGEST, ForesightPrior
from foresight_env.inverse.importance import (
    Proposal,
    adapted,
    mixture_weights,
    weighted_interval,
)
from foresight_env.inverse.truncated import truncated_means
from tests.support.small_games import CROSSING_STATES, crossing, crossing_theta


@pytest.mark.parametrize("mean", [-9.0, -0.4, 0.3, 1.2, 30.0])
def test_a_truncated_gaussian_has_its_known_mean(mean):
    found = truncated_means(np.array([[mean]]), np.array([[[0.25]]]), np.zeros(1), np.ones(1))
    expected = truncnorm((0.0 - mean) / 0.5, (1.0 - mean) / 0.5, mean, 0.5).mean()
    assert found[0, 0] == pytest.approx(expected, abs=0.02)


def test_entries_without_limits_follow_the_limited_ones():
    covariance = np.array([[1.0, 0.8, 0.3], [0.8, 1.0, 0.1], [0.3, 0.1, 2.0]])
    mean = np.array([0.5, -1.0, 2.0])
    low, high = np.array([1.0, -np.inf, -np.inf]), np.array([np.inf, np.inf, np.inf])
    drawn = np.random.default_rng(0).multivariate_normal(mean, covariance, 400_000)
    expected = drawn[drawn[:, 0] > 1.0].mean(axis=0)
    found = truncated_means(mean[None], covariance[None], low, high)
    np.testing.assert_allclose(found[0], expected, atol=0.03)
    free = np.full(3, np.inf)
    np.testing.assert_array_equal(
        truncated_means(mean[None], covariance[None], -free, free)[0], mean
    )


def test_equal_ranks_are_equal_steps_of_the_log_horizon():
    prior = ForesightPrior.of(Exponential(), 25, 0.0, 1.0)
    gamma = prior.at(np.linspace(0.0, 1.0, 6))
    steps = np.diff(np.log(1.0 - gamma + 1.0 / (LONGEST * 25)))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-2)
    np.testing.assert_allclose(prior.ranks(gamma), np.linspace(0.0, 1.0, 6), atol=1e-6)
    assert prior.density(0.9) > 3.0 * prior.density(0.5)
    per_second = ForesightPrior.of(ExponentialPerSecond(0.1), 25, 0.0, 1.0)
    middle = float(per_second.at(np.array(0.5)))
    assert middle**0.1 == pytest.approx(float(gamma[2] + gamma[3]) / 2, abs=0.15)


def test_a_prior_may_reach_above_one():
    prior = ForesightPrior.of(Exponential(), 10, 0.0, 1.2)
    assert (np.diff(prior.rank) > 0.0).all()
    assert prior.ranks(np.array([1.2]))[0] == 1.0


def test_importance_weights_find_a_known_density():
    """A narrow, correlated Gaussian on the cube, from a first proposal three times too wide."""
    mean, deviation = np.array([0.8, 0.6]), np.array([0.02, 0.05])
    covariance = np.outer(deviation, deviation) * np.array([[1.0, 0.7], [0.7, 1.0]])
    precision = np.linalg.inv(covariance)
    points, proposals = np.zeros((0, 2)), []
    proposal = Proposal.of(np.array([0.75, 0.7]), 9.0 * np.diag(deviation**2))
    for number in range(4):
        drawn = proposal.draws(128, number)
        points = np.vstack([points, drawn])
        proposals.append((proposal, len(drawn)))
        away = points - mean
        logs = -0.5 * np.einsum("si,ij,sj->s", away, precision, away)
        weights = mixture_weights(logs, points, proposals)
        proposal = adapted(points, weights)
    np.testing.assert_allclose(weights @ points, mean, atol=0.1 * deviation.min() + 2e-3)
    spread = np.sqrt(weights @ (points - weights @ points) ** 2)
    np.testing.assert_allclose(spread, deviation, rtol=0.15)
    low, high = weighted_interval(points[:, 0], weights, 0.9)
    reach = norm.ppf(0.95) * deviation[0]
    np.testing.assert_allclose([low, high], [mean[0] - reach, mean[0] + reach], atol=0.25 * reach)


def test_draws_lie_in_the_cube_and_their_density_has_mass_one():
    proposal = Proposal.of(np.array([0.95, 0.1]), np.diag([0.09, 0.04]))
    drawn = proposal.draws(500, 1)
    assert ((drawn >= 0.0) & (drawn <= 1.0)).all()
    grid = (np.stack(np.meshgrid(*[np.arange(60)] * 2), -1).reshape(-1, 2) + 0.5) / 60
    assert np.mean(np.exp(proposal.log_density(grid))) == pytest.approx(1.0, abs=0.05)


def test_the_mean_is_exact_where_the_posterior_is_a_truncated_gaussian():
    """One walker without limits is linear-quadratic: its trajectory is linear in its goal."""
    walker = Player(DoubleIntegrator(0.2), (Goal(1.0), Effort(0.1)), control_bounds=None)
    game, state = Game((walker,), 6), [np.array([0.0, 0.0, 0.3, 0.0])]
    true = solve(game, state, [{"goal": np.array([0.45, 0.2])}], 0.8)
    seen = true.states[0] + 0.15 * np.random.default_rng(1).standard_normal((7, 4))

    def fit(limits, **options):
        free = Free(("goal",), False, theta_range=(("goal", limits),))
        return estimate(
            game, seen, full_state((4,)), initial_state=state, gamma=0.8, free=free,
            theta=[{"goal": np.array([0.4, 0.2])}], covariance=0.15**2, **options,
        )  # fmt: skip

    open_, found = fit((-np.inf, np.inf)), fit((0.1, 0.5), posterior=Posterior())
    expected = [
        truncnorm((0.1 - m) / s, (0.5 - m) / s, m, s).mean()
        for m, s in zip(open_.values, open_.deviation, strict=True)
    ]
    assert found.mean is not None
    np.testing.assert_allclose(found.mean.values, expected, atol=0.02)
    at_mean = solve(game, state, [{"goal": np.array(expected)}], 0.8)
    np.testing.assert_allclose(found.mean.states[0], at_mean.states[0], atol=0.02)
    assert found.mean.effective_samples == 1.0  # no discount factor is sampled


def fit_crossing(seen, std, gamma=(0.8, 0.8), **options):
    return estimate(
        crossing(), seen, full_state((4, 4)), initial_state=CROSSING_STATES,
        theta=crossing_theta(), gamma=list(gamma), free=Free(), covariance=std**2,
        prior=Prior(0.0), starts=MultiStart(4), **options,
    )  # fmt: skip


def test_intervals_hold_discount_factors_that_the_prior_draws():
    """The number of intervals that hold the truth is binomial; bounds leave out 1 in 500."""
    prior = ForesightPrior.of(Exponential(), crossing().horizon, 0.0, 1.0)
    random, std, held, count = np.random.default_rng(11), 0.03, 0, 0
    squares = np.zeros(2)
    for _ in range(20):
        gamma = prior.at(random.uniform(0.0, 1.0, 2))
        true = solve(crossing(), CROSSING_STATES, crossing_theta(), gamma)
        if true.status != Status.SOLVED:
            continue
        clean = np.concatenate(true.states, axis=1)
        found = fit_crossing(
            clean + std * random.standard_normal(clean.shape), std, posterior=Posterior()
        )
        assert found.mean is not None
        low, high = found.gamma_interval.T
        held += int(np.sum((low <= gamma) & (gamma <= high)))
        count += 2
        for k, states in enumerate((found.mean.states, found.solution.states)):
            squares[k] += np.sum((np.concatenate(states, axis=1) - clean) ** 2)
    assert count >= 36
    assert binom.ppf(0.001, count, 0.9) <= held <= binom.ppf(0.999, count, 0.9)
    assert squares[0] <= squares[1] * 1.05  # the mean is the better estimate of a trajectory


def test_a_posterior_of_exact_data_is_the_truth():
    gamma = np.array([0.9, 0.7])
    true = solve(crossing(), CROSSING_STATES, crossing_theta(), gamma)
    seen = np.concatenate(true.states, axis=1)
    found = fit_crossing(seen, 1e-3, posterior=Posterior(24))
    assert found.mean is not None
    np.testing.assert_allclose(found.mean.gamma, gamma, atol=0.02)
    np.testing.assert_allclose(np.concatenate(found.mean.states, axis=1), seen, atol=2e-3)
    np.testing.assert_allclose(found.gamma, gamma, atol=0.03)
    assert len(found.mean.values) == len(found.parameters)
    assert found.identifiable.all()


def test_wrong_settings_are_named():
    with pytest.raises(ValueError, match=r"level: is 1.0; expected between 0 and 1"):
        Posterior(level=1.0)
    with pytest.raises(ValueError, match=r"rounds: is 0; expected at least 1"):
        Posterior(rounds=0)
    with pytest.raises(ValueError, match="samples: is 2; expected at least one per round, 4"):
        Posterior(samples=2)
    with pytest.raises(ValueError, match="posterior: is given with a profile"):
        fit_crossing(np.zeros((9, 8)), 0.1, posterior=Posterior(), profile=Profile())
