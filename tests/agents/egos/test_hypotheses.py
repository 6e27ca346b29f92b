"""Plans for several hypotheses: their definition by expected costs, weights, fallbacks."""

from dataclasses import replace

import numpy as np
import pytest

import agents.egos.hypotheses
from agents import Decision
from agents.egos.expected_response import expected_response_game, expected_response_parameters
from agents.egos.hypotheses import Hypotheses, HypothesesMemory, Others, continued, onward
from agents.egos.motion import extrapolate
from agents.egos.planning import looking_ahead, needs_longer_plan
from foresight_env.equilibrium import Status, solve
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)
from foresight_env.games import Equality
from foresight_env.scenarios.crosswalk import (
    COLLISION_WEIGHT,
    CONTROL_WEIGHT,
    GOAL_WEIGHT,
    MARGIN,
    MINIMUM_DISTANCE,
    crosswalk_game,
    player_theta,
)
from foresight_env.scenarios.driving import driving_game
from tests.support.small_crossings import crossing

HORIZON = 8
GAME = crosswalk_game(2, HORIZON)
OWN = np.array([0.0, 0.0, 0.6, 0.0])
THETA = player_theta(np.array([2.0, 0.0]))
STATE = np.array([1.3, 0.4, 0.0, -0.5])
STRAIGHT = {1: extrapolate(GAME.players[1].dynamics, STATE, HORIZON, GAME.dt)}
STOPPED = {1: np.tile(STATE * np.array([1.0, 1.0, 0.0, 0.0]), (HORIZON, 1))}
WEIGHTS = np.array([0.7, 0.3])
NOTHING = Decision(np.full(2, 0.25, dtype=np.float32))


def planned(hypotheses, weights):
    game = expected_response_game(GAME, 0, len(hypotheses))
    theta = expected_response_parameters(GAME, 0, THETA, hypotheses, np.array(weights))
    return np.asarray(solve(game, [OWN], [theta], [1.0], throw=True).controls[0])


def cost(controls, paths):
    """The ego's cost of controls where the others follow these paths, written out."""
    place, velocity, total = OWN[:2], OWN[2:], 0.0
    for control, other in zip(controls, paths[1], strict=True):
        place = place + GAME.dt * velocity + 0.5 * GAME.dt**2 * control
        velocity = velocity + GAME.dt * control
        near = max(0.0, MARGIN * MINIMUM_DISTANCE - np.sum((place - other[:2]) ** 2))
        total += GOAL_WEIGHT * np.sum((place - THETA["goal"]) ** 2)
        total += CONTROL_WEIGHT * control @ control + COLLISION_WEIGHT * near
    return total


def test_no_other_controls_have_a_smaller_expected_cost():
    controls = planned((STRAIGHT, STOPPED), WEIGHTS)

    def expected(found):
        return WEIGHTS @ [cost(found, paths) for paths in (STRAIGHT, STOPPED)]

    least = expected(controls)
    random = np.random.default_rng(0)
    for _ in range(30):
        assert expected(controls + random.normal(0.0, 0.02, controls.shape)) >= least - 1e-6


def test_equal_hypotheses_are_one_best_response():
    theta = best_response_parameters(GAME, 0, THETA, STRAIGHT)
    response = solve(best_response_game(GAME, 0), [OWN], [theta], [1.0], throw=True)
    both = planned((STRAIGHT, STRAIGHT), WEIGHTS)
    np.testing.assert_allclose(both, response.controls[0], atol=1e-4)
    other = planned((STRAIGHT, STOPPED), WEIGHTS)
    assert np.abs(other - both).max() > 0.01


def test_a_game_with_equalities_is_refused():
    players = tuple(
        replace(p, equalities=(Equality(lambda i, t, x, u, theta: u[i][0], 1),))
        for p in GAME.players
    )
    with pytest.raises(ValueError, match="equality"):
        expected_response_game(replace(GAME, players=players), 0, 2)


@pytest.fixture(scope="module")
def begun():
    """The scene of an episode and what the ego may know at its first instant."""
    env = crossing()
    _, infos = env.reset(seed=3)
    states, own = list(infos["pedestrian_0"]["state"]), dict(env.scene.own(0).theta)
    return env.scene, Others(states, [own, own], states)


def test_what_explains_the_others_weighs_more(begun):
    scene, others = begun
    setting = Hypotheses(lag=1)
    places = np.stack([state[:2] for state in others.observed])
    memory = HypothesesMemory(predicted=(np.stack([places, places + 0.5]),))
    _, after = setting.plan(scene, 0, others, None, NOTHING, memory)
    assert after.score[0] == 0.0
    assert after.score[1] == pytest.approx(-2 * 0.5**2 / setting.deviation**2)
    np.testing.assert_allclose(
        setting.weights(after.score), [1.0 - setting.least, setting.least], atol=1e-6
    )
    prior = setting.least + (1.0 - 2.0 * setting.least) * setting.prior
    np.testing.assert_allclose(setting.weights(np.zeros(2)), [prior, 1.0 - prior])


def test_a_decision_holds_its_hypotheses(begun):
    scene, others = begun
    decision, memory = Hypotheses().plan(scene, 0, others, None, NOTHING, HypothesesMemory())
    assert [h.name for h in decision.hypotheses] == ["equilibrium", "no reaction"]
    assert sum(h.weight for h in decision.hypotheses) == pytest.approx(1.0)
    assert all(set(h.predicted) == {1} for h in decision.hypotheses)
    assert len(decision.planned) == looking_ahead(scene).game.horizon
    assert not decision.plan_fallback
    assert memory.solution is not None
    # Without an equilibrium there is nothing to compare later.
    assert np.isnan(memory.predicted[-1]).all()


def test_an_equilibrium_is_continued_straight_on(begun):
    scene, others = begun
    found = solve(scene.game, others.states, others.theta, [1.0, 1.0], throw=True)
    longer = looking_ahead(scene).game
    path = continued(scene, 0, found, others.theta, longer)[1]
    assert path.shape == (longer.horizon, 4)
    shown = scene.game.horizon
    np.testing.assert_array_equal(path[:shown], found.states[1][1:])
    np.testing.assert_allclose(
        np.diff(path[shown - 1 :, :2], axis=0),
        np.tile(scene.dt * path[shown - 1, 2:], (longer.horizon - shown, 1)),
        atol=1e-9,
    )


def test_cars_go_on_along_their_route():
    angle = 0.05 * np.arange(60)
    # A circle of 20 m radius to the left, points 1 m apart.
    route = np.stack(
        [20.0 * np.sin(angle), 20.0 - 20.0 * np.cos(angle), angle, np.full(60, 0.05)], axis=1
    )
    car = driving_game(2).players[1].dynamics
    found = onward(car, {"path": route}, np.array([0.0, 0.0, 8.0, 0.0]), 20, 0.1)
    assert found.shape == (20, 4)
    np.testing.assert_allclose(np.hypot(found[:, 0], found[:, 1] - 20.0), 20.0, atol=0.02)
    np.testing.assert_allclose(found[:, 2], 8.0)
    assert found[-1, 3] == pytest.approx(16.0 / 20.0, abs=0.06)
    straight = onward(car, {}, np.array([0.0, 0.0, 8.0, 0.0]), 20, 0.1)
    np.testing.assert_allclose(straight[-1, :2], [16.0, 0.0])


def test_a_plan_that_is_not_solved_is_the_last_one_or_the_equilibrium(begun, monkeypatch):
    scene, others = begun
    setting, original = Hypotheses(), agents.egos.hypotheses.solve
    _, memory = setting.plan(scene, 0, others, None, NOTHING, HypothesesMemory())

    def failing(*args, **kwargs):
        return original(*args, **kwargs)._replace(status=np.array(Status.ITERATION_LIMIT))

    monkeypatch.setattr(agents.egos.hypotheses, "solve", failing)
    first, without = setting.plan(scene, 0, others, None, NOTHING, HypothesesMemory())
    assert first is NOTHING
    assert without.solution is None
    later, _ = setting.plan(scene, 0, others, None, NOTHING, memory)
    assert later.plan_fallback
    np.testing.assert_allclose(later.action, memory.solution.controls[0][1], atol=1e-6)


def test_longer_plans_are_for_short_horizons_and_cars_that_can_stop(begun):
    scene, others = begun
    assert needs_longer_plan(scene, 0, others.states[0])
    assert not needs_longer_plan(looking_ahead(scene), 0, others.states[0])
    cars = replace(scene, game=driving_game(2, 10))
    for speed, longer in ((9.9, True), (10.1, False)):
        assert needs_longer_plan(cars, 0, np.array([0.0, 0.0, speed, 0.0])) == longer
