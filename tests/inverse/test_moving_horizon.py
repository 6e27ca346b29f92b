"""The online estimator: what it finds, keeps and refuses."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import foresight_env.inverse.window_fit as window_fit
from foresight_env.envs.core.scene import own_first
from foresight_env.equilibrium import Budget, Status, solve
from foresight_env.inverse import Free, MovingHorizonEstimator, Prior
from foresight_env.inverse.arrival_cost import is_initial_state
from foresight_env.inverse.update_phases import TRANSITIONS, UpdateEvent, UpdatePhase
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game, player_theta
from tests.support.small_crossings import HORIZON, WINDOW

GAME = crosswalk_game(2, HORIZON)
MODEL = own_first("full", GAME, 0)
GAMMA = np.array([0.5, 0.6])
STD = 0.002
FREE = (Free((), False, True), Free(("goal",), True, True))
LENGTH = 14
OTHER = slice(4, 8)


def estimator(**changes):
    """Player 0 knows itself and infers goal and discount factor of player 1."""
    arguments = {
        "game": GAME,
        "model": MODEL,
        "free": FREE,
        "covariance": STD**2,
        "window": WINDOW,
        "prior": Prior(gamma_weight=4.0, theta_deviation=(("goal", 3.0),)),
        **changes,
    }
    return MovingHorizonEstimator(**arguments)


@lru_cache
def seen():
    """Noisy observations of the game's equilibrium over a horizon whose end is not felt."""
    setting = MONTE_CARLO
    played = solve(crosswalk_game(2, 25), setting.initial_state, setting.theta, GAMMA, throw=True)
    clean = np.concatenate(played.states, axis=1)[:LENGTH]
    return clean + STD * np.random.default_rng(0).standard_normal(clean.shape)


def start(made):
    theta = [MONTE_CARLO.theta[0], player_theta(seen()[0, 4:6])]
    return made.init(theta, [GAMMA[0], 0.8])


@lru_cache
def run():
    """The states after every update."""
    made = estimator()
    states = [start(made)]
    for row in seen():
        states.append(made.update(states[-1], row))
    return made, states


def test_a_constant_discount_factor_is_recovered():
    _, states = run()
    assert states[1].estimate is None  # one observation identifies nothing
    assert all(s.estimate is not None for s in states[2:])
    assert [s.failures for s in states] == [0] * len(states)
    last = states[-1]
    error = abs(last.gamma[1] - GAMMA[1])
    assert error < 0.05
    assert error < 4.0 * last.estimate.gamma_deviation[1]
    assert error < abs(states[2].gamma[1] - GAMMA[1])
    deviations = [s.estimate.gamma_deviation[1] for s in states[2:]]
    assert deviations[-1] < deviations[0]
    assert last.gamma[0] == GAMMA[0]  # its own, fixed
    np.testing.assert_array_equal(last.theta[0]["goal"], MONTE_CARLO.goals[0])


def test_the_present_is_where_the_window_ends():
    _, states = run()
    for count, state in enumerate(states[2:], start=2):
        assert state.stage == min(count, WINDOW) - 1
        now = np.concatenate([s[state.stage] for s in state.estimate.solution.states])
        assert np.abs(now - seen()[count - 1]).max() < 0.05


def test_where_the_game_explains_what_was_seen_the_present_is_the_fit():
    _, states = run()
    last = states[-1]
    fitted = np.concatenate([s[last.stage] for s in last.estimate.solution.states])
    assert np.abs(np.concatenate(last.present) - fitted).max() < STD


def test_the_present_follows_an_agent_that_no_game_explains():
    """Player 0 stops on the spot: what it has planned is not where it is."""
    made, states = run()
    state, row = states[8], seen()[8].copy()
    row[2:4] = 0.0
    for _ in range(3):
        state = made.update(state, row)
    assert state.reduced_chi_squared > 2.0
    fitted = np.concatenate([s[state.stage] for s in state.estimate.solution.states])
    now = np.concatenate(state.present)
    assert np.abs(fitted[:4] - row[:4]).max() > 20.0 * STD
    assert np.abs(now[:4] - row[:4]).max() < 5.0 * STD


@pytest.mark.parametrize("at", [WINDOW - 2, WINDOW + 3], ids=["filling", "sliding"])
def test_a_failed_fit_keeps_the_estimate(at, monkeypatch):
    made, states = run()
    before = states[at]
    real = window_fit.estimate

    def failed(*args, **kwargs):
        return real(*args, **kwargs)._replace(status=np.asarray(int(Status.ITERATION_LIMIT)))

    monkeypatch.setattr(window_fit, "estimate", failed)
    after = made.update(before, seen()[at])
    assert after.failures == 1
    np.testing.assert_array_equal(after.gamma, before.gamma)
    np.testing.assert_array_equal(after.estimate.values, before.estimate.values)
    # The present has moved on along the trajectory that was estimated before.
    for new, old in zip(
        after.estimate.solution.states, before.estimate.solution.states, strict=True
    ):
        np.testing.assert_array_equal(new[after.stage], old[before.stage + 1])
    assert len(after.observations) == min(at + 1, WINDOW)
    # An observation that no fit has used moves the present all the same, if less than itself.
    elsewhere = seen()[at].copy()
    elsewhere[4] += 20.0 * STD
    moved = made.update(before, elsewhere).present[1][0] - after.present[1][0]
    assert STD < moved < 20.0 * STD
    monkeypatch.undo()
    again = made.update(after, seen()[at + 1])
    assert again.failures == 1
    assert abs(again.gamma[1] - GAMMA[1]) < 0.15
    # A covariance that is not a number is no use either.
    monkeypatch.setattr(
        window_fit,
        "estimate",
        lambda *args, **kwargs: (found := real(*args, **kwargs))._replace(
            covariance=np.full_like(found.covariance, np.nan)
        ),
    )
    assert made.update(before, seen()[at]).failures == 1


@pytest.mark.parametrize("length", [2, WINDOW + 2], ids=["short", "longer than the window"])
def test_an_occluded_agent(length):
    made, states = run()
    state = states[6]
    for row in seen()[6 : 6 + length]:
        hidden = row.copy()
        hidden[OTHER] = np.nan
        state = made.update(state, hidden)
        assert state.estimate is not None
        assert np.isfinite(state.gamma).all()
        now = np.concatenate([s[state.stage] for s in state.estimate.solution.states])
        assert np.isfinite(now).all()
    before = states[6].gamma[1]
    assert abs(state.gamma[1] - before) < 0.15
    # Out of sight, it continues as estimated.
    assert np.abs(now[4:6] - row[4:6]).max() < 0.25
    if 6 + length < LENGTH:
        state = made.update(state, seen()[6 + length])
        assert abs(state.gamma[1] - GAMMA[1]) < 0.15


def test_seeing_nothing_for_longer_than_the_window():
    made, states = run()
    state = states[6]
    for _ in range(WINDOW + 2):
        state = made.update(state, np.full(MODEL.size, np.nan))
        assert state.estimate is not None
        assert abs(state.gamma[1] - states[6].gamma[1]) < 0.2


def test_an_agent_that_was_never_seen_is_waited_for():
    made = estimator()
    state = start(made)
    for row in seen()[:3]:
        hidden = row.copy()
        hidden[OTHER] = np.nan
        state = made.update(state, hidden)
        assert state.estimate is None
    assert state.failures == 2  # the first observation alone is no attempt
    for row in seen()[3:6]:
        state = made.update(state, row)
    assert state.estimate is not None


def test_updates_do_not_change_their_input():
    made, states = run()
    before = states[5]
    kept = before.gamma.copy(), len(before.observations), len(before.beliefs)
    row = seen()[5].copy()
    one, two = made.update(before, row), made.update(before, row)
    np.testing.assert_array_equal(one.gamma, two.gamma)
    np.testing.assert_array_equal(before.gamma, kept[0])
    assert (len(before.observations), len(before.beliefs)) == kept[1:]
    np.testing.assert_array_equal(row, seen()[5])


def test_errors_name_the_argument():
    theta, gamma = MONTE_CARLO.theta, GAMMA
    with pytest.raises(ValueError, match=r"free: .*initial state"):
        estimator(free=(Free((), False, False), FREE[1])).init(theta, gamma)
    with pytest.raises(ValueError, match=r"gamma\[1\]: starts at 1.3; it is estimated in \[0, 1\]"):
        estimator().init(theta, [0.9, 1.3])
    with pytest.raises(ValueError, match=f"game: has horizon {HORIZON}; expected at least"):
        estimator(window=HORIZON + 1).init(theta, gamma)
    with pytest.raises(ValueError, match=r"budget\.fits: is 0; expected at least 1"):
        Budget(fits=0)
    with pytest.raises(ValueError, match="budget: is 'realtime', not made by calling Budget"):
        estimator(budget="realtime")
    with pytest.raises(ValueError, match=r"options: is \{\}, not made by calling SolverOptions"):
        estimator(options={})


def test_tracking_updates_take_few_steps_and_continue_the_last_one():
    _, states = run()
    loose = (5.0 * STD) ** 2  # so that no other equilibrium is looked for
    made, state = estimator(budget=Budget(gauss_newton_steps=1), covariance=loose), states[8]
    for row in seen()[8:]:
        longer = Budget(gauss_newton_steps=8)
        patient = estimator(budget=longer, covariance=loose).update(state, row)
        state = made.update(state, row)
        assert int(state.estimate.num_forward_solves) == 2  # the first game and one step
        assert int(patient.estimate.num_forward_solves) > 2
        assert patient.estimate.cost <= state.estimate.cost
    assert abs(state.gamma[1] - states[-1].gamma[1]) < state.gamma_deviation[1]


def test_the_arrival_cost_is_the_forecast_of_the_fit_before_the_window(monkeypatch):
    """It is about the window's first stage, from observations before it: none counts twice."""
    made, states = run()
    priors = []
    fitted = window_fit.estimate

    def spy(*arguments, **named):
        priors.append(named["prior"])
        return fitted(*arguments, **named)

    monkeypatch.setattr(window_fit, "estimate", spy)
    last = states[-2]
    made.update(last, seen()[LENGTH - 1])
    start = LENGTH - WINDOW  # the window's first observation, counted from 0
    before = states[start].estimate  # made when observations 0 .. start - 1 had come
    expected = np.concatenate([s[len(states[start].observations)] for s in before.solution.states])
    is_state = is_initial_state(before.parameters)
    for prior in priors:
        np.testing.assert_array_equal(prior.mean[is_state], expected)
        np.testing.assert_array_equal(prior.mean[~is_state], before.values[~is_state])


def test_after_a_failure_the_arrival_cost_still_is_about_the_right_stage(monkeypatch):
    made, states = run()
    state = states[WINDOW + 1]
    failed = made.update(state, np.full(MODEL.size, np.nan))
    fitted = window_fit.estimate
    monkeypatch.setattr(
        window_fit, "estimate",
        lambda *a, **k: fitted(*a, **k)._replace(status=np.asarray(int(Status.DIVERGED))),
    )  # fmt: skip
    for k in range(3):
        failed = made.update(failed, seen()[WINDOW + 1 + k])
    assert failed.failures == 3
    stages = [b.stage for b in failed.beliefs]
    assert stages == list(range(failed.total - WINDOW + 1, failed.total + 1))


def test_observations_of_another_size_are_refused():
    made, states = run()
    with pytest.raises(ValueError, match=r"observation: has shape \(10,\); expected \(8,\)"):
        made.update(states[0], np.zeros(10))
    with pytest.raises(ValueError, match="observation: holds an infinite number"):
        made.update(states[0], np.full(8, np.inf))  # the first one, which nothing is fitted to yet
    with pytest.raises(ValueError, match="free: expected a sequence of 2"):
        estimator(free=(Free(),)).init([{}, {}], 0.8)
    with pytest.raises(ValueError, match="free: an online estimator needs every player's initial"):
        estimator(free=Free()).init([{}, {}], 0.8)


@pytest.mark.parametrize("huge", [1e3, 1e8])
def test_outliers_leave_a_belief_to_go_on_from(huge):
    """However large: no covariance that they lead to is one that the next update refuses."""
    made, states = run()
    state, random = states[WINDOW + 1], np.random.default_rng(2)
    for row in seen()[WINDOW + 1 :]:
        spoiled = np.where(random.random(8) < 0.2, huge, row)
        state = made.update(state, spoiled)
        assert np.isfinite(state.gamma).all()
        assert all(np.isfinite(s).all() for s in state.present)


def test_an_ill_conditioned_belief_is_still_one():
    """Variances whose ratio is 1e30, as those after an outlier."""
    made, states = run()
    state = states[WINDOW + 1]
    random = np.random.default_rng(3)
    basis, _ = np.linalg.qr(random.normal(size=(len(state.beliefs[0].mean),) * 2))
    spread = basis @ np.diag(np.logspace(-14, 16, len(basis))) @ basis.T
    beliefs = tuple(b._replace(covariance=spread) for b in state.beliefs)
    following = made.update(state._replace(beliefs=beliefs), seen()[WINDOW + 1])
    assert following.failures == state.failures


def test_an_abandoned_fit_is_redone_where_nothing_is_better(monkeypatch):
    """The shifted solution leads elsewhere, and the observations to nothing."""
    made, states = run()
    at = WINDOW + 1
    fitted, asked = window_fit.estimate, []

    def elsewhere(*arguments, **named):
        given = named["method"].initial_cost_limit
        asked.append((named["initial_guess"] is not None, float(given)))
        found = fitted(*arguments, **named)
        if named["initial_guess"] is None:
            return found._replace(status=np.asarray(int(Status.ITERATION_LIMIT)))
        return found._replace(cost=np.asarray(10.0 * given)) if np.isfinite(given) else found

    monkeypatch.setattr(window_fit, "estimate", elsewhere)
    after = made.update(states[at], seen()[at])
    assert [guessed for guessed, _ in asked] == [True, False, True]
    assert np.isfinite([limit for _, limit in asked]).tolist() == [True, False, False]
    assert after.failures == 0
    assert after.reduced_chi_squared < 2.0


def test_one_fit_per_update_is_enough_for_a_budget_of_one(monkeypatch):
    made, states = run()
    single = replace(made, budget=Budget(gauss_newton_steps=3, fits=1))
    fitted, asked = window_fit.estimate, []

    def unlikely(*arguments, **named):
        asked.append(named["initial_guess"] is not None)
        found = fitted(*arguments, **named)
        return found._replace(cost=np.asarray(1e6))

    monkeypatch.setattr(window_fit, "estimate", unlikely)
    single.update(states[WINDOW], seen()[WINDOW])
    assert asked == [True]


def walk(state, events):
    """Phases that a sequence of events leads through."""
    phases = [state.phase]
    for event in events:
        state = state.after(event)
        phases.append(state.phase)
    return phases


def test_every_phase_is_reached_and_every_transition_is_walked():
    """From WAITING; a walk over the table meets each of its entries."""
    state = start(estimator())
    reached, frontier = {UpdatePhase.WAITING: ()}, [UpdatePhase.WAITING]
    walked = set()
    while frontier:
        phase = frontier.pop()
        for (begin, event), end in TRANSITIONS.items():
            if begin is phase:
                path = (*reached[phase], event)
                assert walk(state, path)[-1] is end
                walked.add((begin, event))
                if end not in reached:
                    reached[end] = path
                    frontier.append(end)
    assert set(reached) == set(UpdatePhase)
    assert walked == set(TRANSITIONS)
    assert {event for _, event in TRANSITIONS} == set(UpdateEvent)


def test_events_that_cannot_follow_are_errors():
    state = start(estimator())
    with pytest.raises(KeyError):
        state.after(UpdateEvent.MISSED)


def test_estimators_and_estimates_print_in_a_few_lines():
    _, states = run()
    for shown in (states[0], states[-1], states[-1].estimate, states[-1].estimate.solution):
        assert len(repr(shown)) < 400
    assert "tracking" in repr(states[-1])
    assert "gamma=[" in repr(states[-1].estimate)
    assert "SOLVED" in repr(states[-1].estimate.solution)
