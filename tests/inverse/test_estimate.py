"""Inference from observations of small games whose parameters are known."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import Budget, SolverOptions, Status, solve
from foresight_env.equilibrium.checks.validation import check_kinds, check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.implicit import equilibrium
from foresight_env.equilibrium.newton.schedule import limits_of
from foresight_env.equilibrium.newton.start import begin
from foresight_env.games import ObservationModel, full_state, positions
from foresight_env.inverse import (
    Free,
    GaussNewton,
    GradientDescent,
    MultiStart,
    NeverSeenError,
    Prior,
    Profile,
    estimate,
)
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_GOALS,
    CROSSING_STATES,
    crossing,
    crossing_theta,
)

FULL = full_state((4, 4))
NO_PRIOR = Prior(gamma_weight=0.0)
TRUTH = np.concatenate([[*CROSSING_GOALS[i], CROSSING_GAMMA[i]] for i in range(2)])


@lru_cache
def played():
    """(T + 1, 8) joint states of the true equilibrium."""
    found = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
    assert found.status == Status.SOLVED
    return np.concatenate(found.states, 1)


def fit(observations, gamma=(0.8, 0.8), *, model=FULL, covariance=1e-4, prior=NO_PRIOR, **more):
    arguments = {"initial_state": CROSSING_STATES, "theta": crossing_theta(), **more}
    return estimate(
        crossing(),
        observations,
        model,
        gamma=gamma,
        covariance=covariance,
        prior=prior,
        **arguments,
    )


@pytest.mark.parametrize("seed", range(5))
def test_noise_free_observations_give_the_parameters_back(seed):
    random = np.random.default_rng(seed)
    start = crossing_theta(CROSSING_GOALS + random.uniform(-0.2, 0.2, (2, 2)))
    found = fit(played(), random.uniform(0.3, 1.0, 2), theta=start)
    assert found.status == Status.SOLVED
    assert found.cost < 1e-8
    np.testing.assert_allclose(found.values, TRUTH, atol=1e-4)
    np.testing.assert_allclose(found.gamma, CROSSING_GAMMA, atol=1e-4)
    np.testing.assert_allclose(found.theta[1]["goal"], CROSSING_GOALS[1], atol=1e-4)
    assert found.names == (
        *("goal[0] of 0", "goal[1] of 0", "gamma of 0"),
        *("goal[0] of 1", "goal[1] of 1", "gamma of 1"),
    )
    assert found.identifiable.all()
    np.testing.assert_allclose(np.concatenate(found.solution.states, 1), played(), atol=1e-5)


def test_covariance_is_the_scatter_of_estimates():
    random = np.random.default_rng(7)
    deviation, trials = 1e-3, 60
    estimates, claimed, states = [], [], []
    for _ in range(trials):
        noisy = played() + deviation * random.normal(size=played().shape)
        found = fit(noisy, CROSSING_GAMMA, covariance=deviation**2)
        assert found.status == Status.SOLVED
        estimates.append(found.values)
        claimed.append(found.covariance)
        states.append(np.concatenate(found.solution.states, 1))
    errors, covariance = np.array(estimates) - TRUTH, np.mean(claimed, axis=0)
    ratio = errors.std(axis=0) / np.sqrt(np.diag(covariance))
    assert ratio.min() > 0.7
    assert ratio.max() < 1.35
    # The normalised squared error is chi-squared with 6 degrees of freedom: mean 6, deviation 0.45.
    normalised = np.einsum("ki,ij,kj->k", errors, np.linalg.inv(covariance), errors)
    assert 4.5 < normalised.mean() < 7.5
    spread = np.concatenate(found.state_deviation, 1)
    assert (spread[0] == 0.0).all()  # x_1 is known
    moving = spread > 0.2 * spread.max()
    ratio = np.std(states, axis=0)[moving] / spread[moving]
    assert ratio.min() > 0.6
    assert ratio.max() < 1.5
    assert (found.deviation == np.sqrt(np.diag(found.covariance))).all()
    np.testing.assert_array_equal(found.gamma_deviation, found.deviation[[2, 5]])


def test_missing_entries_and_a_hidden_agent():
    random = np.random.default_rng(1)
    seen = played().copy()
    seen[5:, 4:] = np.nan  # the second agent is hidden in the second half
    seen[random.random(seen.shape) < 0.1] = np.nan
    found = fit(seen, [0.7, 0.9])
    assert found.status == Status.SOLVED
    np.testing.assert_allclose(found.values, TRUTH, atol=1e-3)
    wrong = np.where(np.isnan(seen), np.nan, played() + 0.05)
    assert fit(wrong, [0.7, 0.9]).cost > 1.0
    assert (found.deviation > fit(played(), [0.7, 0.9]).deviation).all()


def test_the_prior_pulls_towards_its_center():
    free, weak, strong = (
        fit(played(), prior=Prior(weight, 0.5)).gamma for weight in (0.0, 1e2, 1e8)
    )
    assert (np.abs(free - CROSSING_GAMMA) < 1e-4).all()
    assert (np.abs(weak - 0.5) < np.abs(free - 0.5)).all()
    np.testing.assert_allclose(strong, 0.5, atol=1e-3)


def test_a_prior_per_player_pulls_each_its_own_way():
    found = fit(played(), prior=Prior((1e8, 0.0), (0.3, 0.9))).gamma
    assert found[0] == pytest.approx(0.3, abs=1e-3)
    assert found[1] != pytest.approx(0.9, abs=1e-3)


def test_a_prior_on_parameters_holds_the_callers_values():
    elsewhere = crossing_theta(CROSSING_GOALS + 0.1)
    firm, loose = (
        fit(played(), theta=elsewhere, prior=Prior(0.0, theta_deviation=(("goal", width),)))
        for width in (1e-6, 1e6)
    )
    np.testing.assert_allclose(firm.theta[0]["goal"], CROSSING_GOALS[0] + 0.1, atol=1e-6)
    np.testing.assert_allclose(loose.theta[0]["goal"], CROSSING_GOALS[0], atol=1e-3)


def test_an_earlier_posterior_as_prior():
    mean = TRUTH + 0.05
    found = fit(played(), prior=Prior(0.0, mean=mean, information=1e9 * np.eye(6)))
    np.testing.assert_allclose(found.values, mean, atol=1e-3)


def test_gamma_is_open_where_speed_limits_decide():
    """Far goals: all drive at full throttle, whatever their foresight."""
    far = np.array([[60.0, 80.0], [-60.0, 80.0]])
    flat_out = solve(crossing(), CROSSING_STATES, crossing_theta(far), CROSSING_GAMMA)
    assert flat_out.status == Status.SOLVED
    found = fit(np.concatenate(flat_out.states, 1), theta=crossing_theta(far), covariance=1e-2)
    gammas = np.array([parameter.kind == "gamma" for parameter in found.parameters])
    assert not found.identifiable[gammas].any()


def test_gradient_descent_descends_and_agrees_with_gauss_newton():
    """Goals only: with foresight known, the problem is nearly linear."""
    noisy = played() + 0.01 * np.random.default_rng(3).normal(size=played().shape)
    start = crossing_theta(CROSSING_GOALS + 0.05)
    held = Prior(0.0, mean=TRUTH, information=np.diag([0.0, 0.0, 1e12, 0.0, 0.0, 1e12]))
    reference = fit(
        noisy,
        CROSSING_GAMMA,
        covariance=1.0,
        theta=start,
        prior=held,
        method=GaussNewton(cost_tolerance=1e-10),
    )
    found = fit(
        noisy,
        CROSSING_GAMMA,
        covariance=1.0,
        theta=start,
        method=GradientDescent(learning_rate=0.02, max_iterations=1500, tolerance=1e-6),
        free=Free(gamma=False),
        starts=MultiStart(1),
    )
    before = solve(crossing(), CROSSING_STATES, start, CROSSING_GAMMA)
    begun = np.sum((np.concatenate(before.states, 1) - noisy) ** 2)
    assert found.cost < 0.9 * begun
    assert found.cost == pytest.approx(float(reference.cost), rel=1e-3)
    np.testing.assert_allclose(found.values, reference.values[[0, 1, 3, 4]], atol=2e-3)


def test_a_window_predicts_the_rest_and_finds_the_initial_state():
    """Positions only, five of nine stages; the second player is known."""
    start = CROSSING_STATES + np.array([[0.02, -0.03, 0.1, -0.1], [0, 0, 0, 0]])
    found = fit(
        played()[:5, [0, 1, 4, 5]],
        [0.8, CROSSING_GAMMA[1]],
        model=positions((4, 4)),
        covariance=1e-6,
        initial_state=start,
        theta=crossing_theta(CROSSING_GOALS + np.array([[0.1, -0.1], [0, 0]])),
        free=(Free(initial_state=True), Free((), gamma=False)),
        starts=MultiStart(3),
    )
    assert found.status == Status.SOLVED
    np.testing.assert_allclose(found.initial_state[0], CROSSING_STATES[0], atol=1e-3)
    np.testing.assert_array_equal(found.initial_state[1], CROSSING_STATES[1])
    np.testing.assert_array_equal(found.theta[1]["goal"], CROSSING_GOALS[1])
    assert found.gamma[1] == CROSSING_GAMMA[1]
    assert found.gamma_deviation[1] == 0.0
    assert len(found.names) == 7
    assert found.names[3:] == tuple(f"initial_state[{k}] of 0" for k in range(4))
    for i, states in enumerate(found.solution.states):
        assert states.shape == (9, 4)
        np.testing.assert_allclose(states, played()[:, 4 * i : 4 * i + 4], atol=5e-3)


@pytest.mark.parametrize("iterations", [1, 80])
def test_the_solution_is_the_games_however_the_search_was_smoothed(iterations):
    found = fit(played(), [0.7, 0.9], method=GaussNewton(iterations), starts=MultiStart(1))
    assert found.status == Status.SOLVED
    again = solve(crossing(), found.initial_state, found.theta, found.gamma)
    for states, expected in zip(found.solution.states, again.states, strict=True):
        np.testing.assert_allclose(states, expected, atol=1e-6)


def test_the_search_is_not_smoothed_near_a_guess():
    initial_guess = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
    near = fit(played(), CROSSING_GAMMA - 0.01, initial_guess=initial_guess, starts=MultiStart(1))
    far = fit(played(), CROSSING_GAMMA - 0.01, starts=MultiStart(1))
    np.testing.assert_allclose(near.values, far.values, atol=1e-4)
    assert near.num_forward_solves < far.num_forward_solves
    plain = fit(played(), [0.7, 0.9], method=GaussNewton(smoothing=(1e-9, 1e-9)))
    np.testing.assert_allclose(plain.values, far.values, atol=1e-4)
    with pytest.raises(ValueError, match=r"smoothing: is \(0.1, 0.0\)"):
        GaussNewton(smoothing=(0.1, 0.0))


def test_starts_do_not_share_a_local_minimum():
    """The observed part ends far from the goals: from there every discount factor leads to a
    crossing on which agents keep their distance to the end, which the true one does not."""
    game, setting = crosswalk_game(2, 10, "soft"), MONTE_CARLO
    truth = solve(game, setting.initial_state, setting.theta, setting.gamma)
    states = np.concatenate(truth.states, 1)
    last = (states[-1, :2], states[-1, 4:6])
    start = tuple({**t, "goal": seen} for t, seen in zip(setting.theta, last, strict=True))
    found = estimate(
        game,
        states,
        FULL,
        initial_state=setting.initial_state,
        theta=start,
        gamma=(0.8, 0.8),
        covariance=1e-4,
        prior=NO_PRIOR,
    )
    assert found.start_costs.max() > 100.0
    assert found.cost < 1e-6
    np.testing.assert_allclose(found.gamma, setting.gamma, atol=1e-3)


def test_the_gamma_1_baseline_has_the_reference_error():
    """Squared error of the best gamma = 1 fit to the noise-free Monte Carlo crossing: 0.765."""
    game, setting = crosswalk_game(2, 25, "reference"), MONTE_CARLO
    truth = solve(game, setting.initial_state, setting.theta, setting.gamma)
    states = np.concatenate(truth.states, 1)
    found = estimate(
        game,
        states,
        FULL,
        initial_state=setting.initial_state,
        theta=setting.theta,
        gamma=1.0,
        free=Free(gamma=False),
        prior=NO_PRIOR,
        starts=MultiStart(1),
    )
    assert found.status == Status.SOLVED
    np.testing.assert_array_equal(found.gamma, [1.0, 1.0])
    error = np.sum((np.concatenate(found.solution.states, 1) - states) ** 2)
    assert error == pytest.approx(0.765, abs=0.005)
    assert found.cost == pytest.approx(error, rel=1e-6)


SKEW = np.eye(8)
SKEW[0, 0] = -1.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"observations": np.zeros((9, 7))}, r"observations: have shape \(9, 7\)"),
        ({"observations": np.zeros(8)}, "observations: have shape"),
        ({"observations": np.zeros((1, 8))}, "observations: 1 stages"),
        ({"observations": np.zeros((10, 8))}, "observations: 10 stages"),
        ({"observations": np.full((9, 8), np.inf)}, "observations: contain infinity"),
        ({"observations": np.full((9, 8), np.nan)}, "observations: every entry is missing"),
        ({"covariance": np.ones(8)}, r"covariance: has shape \(8,\)"),
        ({"covariance": 0.0}, "covariance: is not symmetric positive definite"),
        ({"covariance": SKEW}, "covariance: is not symmetric positive definite"),
        ({"covariance": np.eye(8) + np.eye(8, k=1) * 0.5}, "covariance: is not symmetric"),
        ({"covariance": np.nan}, "covariance"),
        ({"free": (Free(),)}, "free: has 1 entries"),
        ({"free": Free(("speed",))}, r"free\[0\].theta: names 'speed'"),
        ({"free": Free((), gamma=False)}, "free: nothing is free"),
        ({"prior": Prior(gamma_weight=(1.0,) * 3)}, "prior.gamma_weight: is .*one per player"),
        ({"prior": Prior(gamma_center=-1.0)}, "prior.gamma_center: is -1.0"),
        ({"prior": Prior(mean=np.ones(1))}, "prior: mean and information belong together"),
        ({"prior": Prior(mean=np.ones(1), information=np.eye(1))}, "prior: mean"),
        (
            {"prior": Prior(mean=np.zeros(6), information=-np.eye(6))},
            "prior.information: is not positive semidefinite",
        ),
        ({"prior": Prior(theta_deviation=(("speed", 1.0),))}, "theta_deviation: names 'speed'"),
        ({"prior": Prior(theta_deviation=(("goal", 0.0),))}, "theta_deviation: 'goal' is 0"),
        (
            {
                "initial_guess": solve(crossing(), CROSSING_STATES, crossing_theta(), 0.9)._replace(
                    point=solve(crossing(horizon=9), CROSSING_STATES, crossing_theta(), 0.9).point
                )
            },
            "initial_guess: solves another game",
        ),
        ({"gamma": [0.5, np.nan]}, "gamma: contains NaN"),
        ({"initial_state": np.zeros((2, 3))}, r"initial_state\[0\]|initial_state"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_bad_arguments_are_named(change, named):
    arguments = {"observations": np.zeros((9, 8)), **change}
    with pytest.raises(ValueError, match=named):
        fit(arguments.pop("observations"), **arguments)


def test_cost_parameters_are_looked_for_in_their_range():
    """Goals below 0.3 are ruled out, although they are the truth: the limit holds, and is met."""
    seen = played()
    free = Free(theta_range=(("goal", (0.3, np.inf)),))
    found = fit(seen, theta=crossing_theta(CROSSING_GOALS + 0.4), free=free, covariance=1e-4)
    goals = np.array([theta["goal"] for theta in found.theta])
    assert (CROSSING_GOALS < 0.3).any()
    assert goals.min() == pytest.approx(0.3, abs=1e-6)
    assert found.cost > 1.0  # without limits, 0
    with pytest.raises(ValueError, match=r"goal\[\d\] of \d starts at .*free.theta_range"):
        fit(seen, theta=crossing_theta(CROSSING_GOALS), free=free)
    for wrong in ((("weight", (0.0, 1.0)),), (("goal", (1.0, 0.0)),)):
        with pytest.raises(ValueError, match="theta_range: "):
            Free(theta_range=wrong)


def test_discount_factors_are_looked_for_in_their_range():
    eager = np.array([1.05, 0.7])  # player 0 weighs later costs more than present ones
    truth = solve(crossing(), CROSSING_STATES, crossing_theta(), eager, throw=True)
    seen = np.concatenate(truth.states, 1)
    usual = fit(seen, covariance=1e-8)
    assert usual.gamma[0] <= 1.0
    assert usual.cost > 100.0  # what it cannot explain, it shows
    wide = fit(seen, covariance=1e-8, free=(Free(gamma_range=(0.0, 1.2)), Free()))
    np.testing.assert_allclose(wide.gamma, eager, atol=1e-4)
    narrow = fit(seen, covariance=1e-8, free=Free(gamma_range=(0.75, 0.9)))
    np.testing.assert_allclose(narrow.gamma, [0.9, 0.75], atol=1e-6)
    with pytest.raises(ValueError, match=r"gamma of 0 starts at 1.1; it is estimated in \[0, 1\]"):
        fit(seen, (1.1, 0.8))
    with pytest.raises(ValueError, match=r"gamma_range: is \(0.9, 0.2\); expected \(low, high\)"):
        Free(gamma_range=(0.9, 0.2))


def test_trial_steps_have_one_short_phase():
    """One Newton step solves no cold game; a fit's first game gets all the steps it needs."""
    layout, options = layout_of(crossing()), SolverOptions()
    hasty = Budget(trial_newton_steps=1)
    with jax.enable_x64(True):
        parameters = check_parameters(
            crossing(), CROSSING_STATES, crossing_theta(), np.array(CROSSING_GAMMA)
        )
        start = begin(layout, options, jax.tree.map(jnp.asarray, parameters), None)
        solve_from = jax.jit(partial(equilibrium, layout, options))
        trial, real = (
            solve_from(
                parameters, start._replace(limits=limits_of(hasty).of_trial(jnp.asarray(value)))
            )
            for value in (True, False)
        )
    assert not trial.success
    assert int(trial.iterations) == 1
    assert real.success
    assert int(real.iterations) > 1
    found = fit(played(), theta=crossing_theta(CROSSING_GOALS + 0.2), budget=hasty)
    assert found.status == Status.SOLVED


def test_a_wrong_initial_state_is_called_what_the_caller_calls_it():
    with pytest.raises(ValueError, match=r"initial_state\[0\]: has shape \(3,\); expected \(4,\)"):
        fit(played(), initial_state=np.zeros((2, 3)))


@pytest.mark.parametrize("given", [True, Profile, "profile"])
def test_settings_of_the_wrong_kind_are_named(given):
    with pytest.raises(ValueError, match=r"profile: is .*, not made by calling Profile\(\.\.\.\)"):
        check_kinds(profile=(given, Profile, type(None)))
    check_kinds(profile=(None, Profile, type(None)), other=(Profile(), Profile))


def test_starts_are_spread_over_the_range_that_is_searched():
    values, open_gammas = np.zeros(3), np.array([False, True, True])
    low, high = np.array([-np.inf, 0.0, 0.0]), np.array([np.inf, 0.25, 1.2])
    starts = MultiStart(8, (0.3, 1.5)).spread(values, open_gammas, (low, high))[1:]
    assert (starts[:, 0] == 0.0).all()
    assert 0.0 < starts[:, 1].min() < starts[:, 1].max() < 0.25  # nothing in common: the limits
    assert 0.3 < starts[:, 2].min() < 0.6
    assert 0.9 < starts[:, 2].max() < 1.2


def test_a_search_that_begins_too_far_off_ends():
    elsewhere = crossing_theta(CROSSING_GOALS + 0.3)
    options = {"theta": elsewhere, "starts": MultiStart(1)}
    given_up = fit(
        played(),
        method=GaussNewton(smoothing=(), tracking_weights=(), initial_cost_limit=1.0),
        **options,
    )
    assert int(given_up.num_forward_solves) == 1
    assert given_up.cost > 1.0
    np.testing.assert_array_equal(given_up.gamma, [0.8, 0.8])
    near = solve(crossing(), CROSSING_STATES, elsewhere, CROSSING_GAMMA)
    usual = fit(played(), initial_guess=near, method=GaussNewton(initial_cost_limit=1.0), **options)
    assert int(usual.num_forward_solves) == 1  # an initial guess leaves smoothing out
    smoothed = fit(played(), method=GaussNewton(initial_cost_limit=1.0), **options)
    assert int(smoothed.num_forward_solves) > 1  # what a smoothed game costs is another matter
    gone_on = fit(played(), method=GaussNewton(smoothing=(), initial_cost_limit=1e9), **options)
    assert int(gone_on.num_forward_solves) > 1
    assert gone_on.cost < 1e-8


def test_the_solution_of_an_estimate_is_that_of_its_game():
    found = fit(played()[:5], method=GaussNewton(max_iterations=2))
    assert found.status == Status.SOLVED
    assert found.solution.iterations == found.num_newton_steps > 0
    again = solve(
        crossing(),
        found.initial_state,
        found.theta,
        found.gamma,
        initial_guess=found.solution,
        budget=Budget(phases=1),
    )
    assert again.iterations == 0  # nothing is left to be done
    np.testing.assert_allclose(found.solution.residual, again.residual, rtol=1e-3, atol=1e-12)


def test_an_estimate_prints_in_a_few_lines():
    found = fit(played()[:5])
    told = str(found)
    assert told.startswith("Estimate(SOLVED")
    assert "iterations=" in told
    assert f"{found.gamma[0]:.2f}" in told
    assert len(told) < 300


def hidden(rows, columns):
    """Observations of which these are missing."""
    seen = played()[:5].copy()
    seen[rows, columns] = np.nan
    return seen


EVERYTHING, SECOND = slice(None), slice(4, 8)


def test_observations_that_say_nothing_are_refused():
    with pytest.raises(ValueError, match="observations: every entry is missing"):
        fit(hidden(EVERYTHING, EVERYTHING))
    with pytest.raises(ValueError, match="observations: every entry after x_1 is missing"):
        fit(hidden(slice(1, None), EVERYTHING))


@pytest.mark.parametrize("free", [Free(initial_state=True), (Free(), Free((), False, True))])
def test_an_agent_that_was_never_seen_has_no_free_initial_state(free):
    with pytest.raises(NeverSeenError, match="player 1 was never observed"):
        fit(hidden(EVERYTHING, SECOND), free=free)


def test_an_unseen_agent_is_fitted_where_something_else_tells_of_it():
    unseen = hidden(EVERYTHING, SECOND)
    assert fit(unseen).status == Status.SOLVED  # its initial state is known
    free = (Free((), True), Free((), False, True))
    believed = Prior(0.0, mean=np.array([0.9, *CROSSING_STATES[1]]), information=np.eye(5))
    assert fit(unseen, free=free, prior=believed, gamma=CROSSING_GAMMA).status == Status.SOLVED
    between = ObservationModel(lambda x: x[0][:2] - x[1][:2], (None, None))
    gaps = played()[:5, :2] - played()[:5, 4:6]
    assert fit(gaps, model=between, free=Free((), True, True)).status == Status.SOLVED
