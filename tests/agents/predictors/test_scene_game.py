"""The scene's own game as a predictor."""

from dataclasses import replace

import numpy as np
import pytest

from agents import Context, History, SceneGamePredictor, make_predictor
from agents.conformance import check_predictor, game_histories, histories
from agents.egos.predict_then_plan import context_of
from agents.predictors import scene_game
from evaluation.rollout.setting import RunSetting
from evaluation.windows.simulated import windows_of
from foresight_env.envs.crosswalk_v0 import parallel_env
from foresight_env.equilibrium import Status

STEPS = 6


@pytest.fixture(scope="module")
def windows():
    """Of crossings that the game itself generated, without noise."""
    setting = RunSetting("crosswalk", noise_std=0.0)
    return [w for seed in (1000, 1001) for w in windows_of(setting, seed, "crosswalk")]


def error(window, name):
    path = make_predictor(name).predict(window.history, STEPS).most_likely
    return float(np.nanmean(np.linalg.norm(path - window.truth, axis=-1)))


def test_the_game_s_own_episodes_are_predicted_from_noise_free_histories(windows):
    errors = np.array([[error(w, n) for n in ("scene-game", "constant-velocity")] for w in windows])
    assert len(errors) >= 4
    assert np.median(errors[:, 0]) < 0.02
    assert errors[:, 0].mean() < 0.2 * errors[:, 1].mean()
    assert (errors[:, 0] < errors[:, 1]).all()


def test_the_true_discount_factors_predict_better_than_gamma_1(windows):
    assert np.mean([error(w, "scene-game") for w in windows]) < 0.7 * np.mean(
        [error(w, "scene-game-gamma-1") for w in windows]
    )


@pytest.mark.parametrize("name", ["scene-game", "scene-game-gamma-1"])
def test_it_conforms_where_the_game_is_known(name):
    check_predictor(make_predictor(name), game_histories())


def test_discount_factors_are_1_or_inferred():
    history = dict(game_histories())["a crosswalk with its game"]
    fixed = SceneGamePredictor(infer=False).predict(history, STEPS)
    assert (fixed.gamma == 1.0).all()
    assert not fixed.fallback
    inferred = SceneGamePredictor().predict(history, STEPS)
    assert (inferred.gamma < 1.0).all()
    assert (inferred.gamma_deviation > 0.0).all()


def test_no_agent_s_own_parameters_are_in_the_context():
    env = parallel_env(controlled=(0,))
    env.reset(seed=0)
    goal = env.scene.own(0).theta["goal"]
    env.reset(seed=1)
    assert not np.array_equal(goal, env.scene.own(0).theta["goal"])
    first, second = (context_of(replace(env.scene, _own=own)) for own in ({}, env.scene._own))
    assert first.game.population == second.game.population
    for theta in second.game.population.theta:
        assert not np.array_equal(theta["goal"], env.scene.own(0).theta["goal"])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda h: replace(h, context=Context()), "history.context.game: is None"),
        (lambda h: replace(h, dt=0.25), "history.dt: is 0.25 s; expected a multiple"),
        (
            lambda h: History(
                h.states[:, :1], h.headings[:, :1], h.kinds[:1], h.extents[:1], h.dt, h.context
            ),
            "has 2 players; expected one for each of the history's 1 agents",
        ),
    ],
)
def test_histories_that_do_not_fit_are_refused(changed, message):
    history = dict(game_histories())["a crosswalk with its game"]
    with pytest.raises(ValueError, match=message):
        SceneGamePredictor().predict(changed(history), STEPS)


def test_histories_without_a_game_are_refused():
    with pytest.raises(ValueError, match=r"history\.context\.game: is None"):
        SceneGamePredictor().predict(dict(histories())["two pedestrians"], STEPS)


def test_a_single_observation_and_a_failed_fit_fall_back(monkeypatch):
    cases = dict(game_histories())
    straight = make_predictor("constant-velocity")
    single = cases["a crosswalk with its game, a single observation"]
    found = SceneGamePredictor().predict(single, STEPS)
    assert found.fallback
    history = cases["a crosswalk with its game"]
    estimate = scene_game.estimate

    def failed(*args, **kwargs):
        status = np.asarray(int(Status.ITERATION_LIMIT))
        return estimate(*args, **kwargs)._replace(status=status)

    monkeypatch.setattr(scene_game, "estimate", failed)
    found = SceneGamePredictor().predict(history, STEPS)
    assert found.fallback
    np.testing.assert_array_equal(found.positions, straight.predict(history, STEPS).positions)


def test_where_re_planning_fails_the_fitted_equilibrium_is_continued(monkeypatch):
    history = dict(game_histories())["a crosswalk with its game, unseen at times"]
    predictor = SceneGamePredictor()
    fitted = predictor.fit(history, STEPS)
    solve = scene_game.solve

    def failed(*args, **kwargs):
        return solve(*args, **kwargs)._replace(status=np.asarray(int(Status.ITERATION_LIMIT)))

    monkeypatch.setattr(scene_game, "solve", failed)
    found = predictor.predict(history, STEPS)
    assert not found.fallback
    rows = 12 + 4 * np.arange(1, STEPS + 1)
    for j, states in enumerate(fitted.solution.states):
        np.testing.assert_array_equal(found.positions[0, :, j], states[rows, :2])
