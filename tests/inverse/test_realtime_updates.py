"""Updates of one game each: the step on the last fit's derivatives, and what follows failures."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import foresight_env.inverse.window_fit as window_fit
from agents import make_ego
from foresight_env.envs import crosswalk_v0
from foresight_env.equilibrium import Budget, Status, solve
from foresight_env.inverse import Rates, UpdatePhase, estimate
from foresight_env.inverse.arrival_cost import is_initial_state
from foresight_env.inverse.moving_horizon import smoothed_options
from foresight_env.inverse.window_fit import moved_along, rates_of
from tests.inverse.test_moving_horizon import (
    GAMMA,
    LENGTH,
    STD,
    WINDOW,
    estimator,
    run,
    seen,
    start,
)


@lru_cache
def realtime_run():
    made = estimator(budget=Budget.realtime())
    states = [start(made)]
    for row in seen():
        states.append(made.update(states[-1], row))
    return made, states


def test_each_update_solves_one_game_and_finds_what_patient_ones_find():
    _, states = realtime_run()
    _, patient = run()
    assert [int(s.estimate.num_forward_solves) for s in states[2:]] == [2] + [1] * (LENGTH - 2)
    last = states[-1]
    assert last.failures == 0
    assert abs(last.gamma[1] - GAMMA[1]) < 0.05
    assert abs(last.gamma[1] - patient[-1].gamma[1]) < last.gamma_deviation[1]


@pytest.mark.parametrize("at", [WINDOW - 2, WINDOW + 2], ids=["filling", "sliding"])
def test_the_rates_are_those_of_the_moved_fit(at):
    """Against solving its game again with changed parameters."""
    made, states = realtime_run()
    found, sliding = states[at].estimate, at >= WINDOW
    moved = moved_along(found, sliding)
    rates, ahead = rates_of(moved), int(sliding)
    options, small = smoothed_options(made.covariance), 1e-5
    base = np.concatenate(found.solution.states, axis=1)
    for k, parameter in enumerate(found.parameters):
        initial_state = [s.copy() for s in found.initial_state]
        theta, gamma = [dict(t) for t in found.theta], found.gamma.copy()
        player, change = parameter.player, small
        if parameter.kind == "gamma":
            gamma[player] -= small
            change = -small
        elif parameter.kind == "initial_state":
            initial_state[player][parameter.index] += small
        else:
            theta[player]["goal"] = theta[player]["goal"].copy()
            theta[player]["goal"][parameter.index] += small
        again = solve(
            made.game, initial_state, theta, gamma, initial_guess=found.solution, options=options
        )
        slope = (np.concatenate(again.states, axis=1) - base)[ahead:] / change
        np.testing.assert_allclose(
            rates.states[: len(slope) - 1, :, k], slope[:-1], atol=2e-3, err_msg=str(parameter)
        )
        is_state = is_initial_state(found.parameters)
        np.testing.assert_allclose(
            rates.carry[is_state, k], slope[0], atol=2e-3, err_msg=str(parameter)
        )
        np.testing.assert_array_equal(
            rates.carry[~is_state, k], np.eye(len(is_state))[~is_state, k]
        )


def test_the_step_explains_the_new_observation_better():
    """Compared with the same fit moved along without it."""
    made, states = realtime_run()
    before, row = states[WINDOW], seen()[WINDOW].copy()
    row[4:6] += 5.0 * STD
    fits = []
    fitted = window_fit.estimate

    def spy(*arguments, **named):
        fits.append((arguments, named))
        return fitted(*arguments, **named)

    patch = pytest.MonkeyPatch()
    with patch.context() as m:
        m.setattr(window_fit, "estimate", spy)
        stepped = made.update(before, row)
    (arguments, named), *others = fits
    assert not others
    plain = fitted(*arguments, **{**named, "initial_guess_rates": None})
    assert stepped.estimate.cost < 0.7 * plain.cost
    assert (
        stepped.estimate.cost > fitted(*arguments, **{**named, "method": made.method}).cost * 0.99
    )


def test_rates_of_something_else_are_refused():
    made, states = realtime_run()
    found = states[WINDOW].estimate
    rates = rates_of(found)
    arguments = {
        "initial_state": found.initial_state,
        "theta": found.theta,
        "gamma": found.gamma,
        "free": made.free,
    }
    window = seen()[:WINDOW]
    with pytest.raises(ValueError, match=r"initial_guess_rates: .* with an initial guess only"):
        estimate(made.game, window, made.model, **arguments, initial_guess_rates=rates)
    short = Rates(rates.states[1:], rates.carry)
    with pytest.raises(ValueError, match=r"initial_guess_rates: has states \(.*expected"):
        estimate(
            made.game,
            window,
            made.model,
            **arguments,
            initial_guess=found.solution,
            initial_guess_rates=short,
        )


def test_failures_lead_to_relocating_and_then_to_searching(monkeypatch):
    made, states = realtime_run()
    state = states[8]
    calls = []
    real = window_fit.estimate

    def failed(*args, **kwargs):
        limited = kwargs["budget"] == Budget.realtime()
        calls.append((kwargs["initial_guess"] is None, limited, kwargs["starts"].count))
        return real(*args, **kwargs)._replace(status=np.asarray(int(Status.ITERATION_LIMIT)))

    monkeypatch.setattr(window_fit, "estimate", failed)
    phases = []
    for row in seen()[8:12]:
        phases.append(state.phase)
        state = made.update(state, row)
    assert phases == [
        UpdatePhase.TRACKING,
        UpdatePhase.RELOCATING,
        UpdatePhase.SEARCHING,
        UpdatePhase.SEARCHING,
    ]
    assert calls == [(False, True, 1), (True, True, 1), (True, False, 2), (True, False, 2)]
    assert state.failures == 4
    np.testing.assert_array_equal(state.gamma, states[8].gamma)
    monkeypatch.undo()
    for row in seen()[12:]:
        state = made.update(state, row)
    assert state.failures == 4
    assert abs(state.gamma[1] - GAMMA[1]) < 0.15


def test_an_unexplained_observation_leads_to_one_relocation():
    """Player 1 is elsewhere: not a failure, and one game per update all the same."""
    made, states = realtime_run()
    state, row = states[8], seen()[8].copy()
    row[4:6] += 0.5
    state = made.update(state, row)
    assert state.phase is UpdatePhase.RELOCATING
    assert state.reduced_chi_squared > 10.0
    after = made.update(state, seen()[9])
    assert after.phase is UpdatePhase.TRACKING
    assert after.failures == 0
    assert after.initial_guess is not None


@pytest.mark.parametrize(
    ("players", "budget"), [(2, Budget.online()), (3, Budget.realtime())], ids=["two", "three"]
)
def test_egos_have_the_budget_of_their_games(players, budget):
    env = crosswalk_v0.parallel_env(players)
    env.reset(seed=0)
    ego = make_ego("infer-gamma")
    assert ego.init(env.scene, 0).estimator.budget == budget
    other = replace(ego, budget=Budget(fits=2)).init(env.scene, 0)
    assert other.estimator.budget == Budget(fits=2)


def test_an_estimator_with_its_own_options_keeps_its_budget(monkeypatch):
    made, states = realtime_run()
    own = replace(made, options=smoothed_options(4.0 * made.covariance))
    asked = []
    real = window_fit.estimate

    def spy(*args, **kwargs):
        asked.append((kwargs["budget"], kwargs["options"]))
        return real(*args, **kwargs)

    monkeypatch.setattr(window_fit, "estimate", spy)
    own.update(states[8], seen()[8])
    assert asked == [(Budget.realtime(), own.options)]
