"""Simulation under given actions, and the search that never ends worse than what it begins with."""

import numpy as np
import pytest

from evaluation.rollout import clairvoyant
from evaluation.rollout.clairvoyant import Clairvoyant
from evaluation.rollout.endings import COLLISION, ending
from evaluation.rollout.episode import begin_episode, episode
from evaluation.rollout.setting import RunSetting
from evaluation.rollout.simulation import Score, simulate
from tests.support.small_crossings import crossing

GAMMAS = (0.2, 0.7)
NOTHING = np.zeros((1, 2))


def recorded(ego, seed, **arguments):
    env = crossing(max_steps=30, **arguments)
    return env, list(episode(env, RunSetting(others_gamma=GAMMAS), ego, seed))


@pytest.mark.parametrize("ego", ["oracle", "constant-velocity"])
def test_recorded_actions_repeat_the_episode(ego):
    env, steps = recorded(ego, 3)
    actions = np.stack([s.decision.action for s in steps])
    found = simulate(env, 3, GAMMAS, actions)
    assert found.finished
    np.testing.assert_array_equal(found.actions, actions)
    np.testing.assert_array_equal(found.states[:-1], np.stack([s.state for s in steps]))
    np.testing.assert_array_equal(found.states[-1], steps[-1].info["state"])
    assert found.ended == ending(steps[-1].info)
    cost = -sum(s.info["reward"] for s in steps) * env.scene.dt
    assert found.score == (found.ended == COLLISION, pytest.approx(cost))


def test_the_others_react():
    env = crossing(max_steps=30)
    still = simulate(env, 0, GAMMAS, NOTHING)
    towards = simulate(env, 0, GAMMAS, np.tile([-1.0, -1.0], (30, 1)))
    n = min(len(still.states), len(towards.states))
    assert np.abs(still.states[:n, 1] - towards.states[:n, 1]).max() > 0.01


def test_a_limit_of_the_cost_stops_the_simulation():
    env = crossing(max_steps=30)
    whole = simulate(env, 0, GAMMAS, NOTHING)
    cut = simulate(env, 0, GAMMAS, NOTHING, limit=0.5 * whole.score.cost)
    assert whole.finished
    assert not cut.finished
    assert 0.5 * whole.score.cost <= cut.score.cost < whole.score.cost
    assert len(cut.actions) < len(whole.actions)


def test_harm_is_worse_than_any_cost():
    assert Score(False, 100.0) < Score(True, 1.0) < Score(True, 2.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_is_not_worse_than_any_of_the_given(seed):
    given = []
    for ego in ("oracle", "constant-velocity"):
        env, steps = recorded(ego, seed)
        given.append(np.stack([s.decision.action for s in steps]))
    given.append(NOTHING)
    best = Clairvoyant(candidates=6).respond(env, seed, GAMMAS, given)
    scores = [simulate(env, seed, GAMMAS, actions).score for actions in given]
    assert best.finished
    assert best.score <= min(scores)
    # What it returns is an episode that its actions lead to.
    assert simulate(env, seed, GAMMAS, best.actions).score == best.score


def test_it_improves_on_standing_still():
    env = crossing(max_steps=40)
    still = simulate(env, 1, GAMMAS, NOTHING)
    best = Clairvoyant(candidates=8).respond(env, 1, GAMMAS, [NOTHING])
    assert best.score.cost < 0.7 * still.score.cost
    assert best.info["goal_reached"]


def test_without_candidates_the_best_given_is_returned():
    env = crossing(max_steps=20)
    away = np.tile([1.0, 1.0], (20, 1))
    best = Clairvoyant(candidates=0).respond(env, 0, GAMMAS, [away, NOTHING])
    np.testing.assert_array_equal(best.actions, np.zeros((20, 2), np.float32))


def test_a_plan_that_is_not_found_is_passed_over(monkeypatch):
    monkeypatch.setattr(clairvoyant, "_planned", lambda *arguments: None)
    env = crossing(max_steps=20)
    best = Clairvoyant().respond(env, 0, GAMMAS, [NOTHING])
    assert best.score == simulate(env, 0, GAMMAS, NOTHING).score


def test_nothing_given_is_refused():
    with pytest.raises(ValueError, match="given: is empty"):
        Clairvoyant().respond(crossing(), 0, GAMMAS, [])


def test_starts_that_pass_alike_are_searched_once():
    env = crossing(max_steps=20)
    start = simulate(env, 0, GAMMAS, NOTHING)
    near = start._replace(states=start.states + 0.01)
    far = start._replace(states=start.states[:9] + 1.0)
    assert clairvoyant._different([start, near, far], 0) == [start, far]


def test_hidden_discount_factors_are_those_of_the_egos_episodes():
    env = crossing()
    _, infos = begin_episode(env, 5, GAMMAS)
    gamma = infos["pedestrian_0"]["gamma"]
    assert gamma[0] == 0.95
    assert GAMMAS[0] <= gamma[1] <= GAMMAS[1]
