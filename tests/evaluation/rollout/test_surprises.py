"""Surprises do what they say, to the others and to what the ego observes, and nothing else."""

import numpy as np
import pytest

from evaluation.rollout.episode import run_episode
from evaluation.rollout.setting import RunSetting
from evaluation.rollout.surprises import (
    CHANGE_TIME,
    IGNORING,
    LONG_SIGHT,
    SHORT_SIGHT,
    SURPRISES,
    ChangingGamma,
    IgnoringOthers,
    observed,
)
from foresight_env.envs.core.behaviours import BehaviourSetting, Receding
from foresight_env.equilibrium import solve
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game
from foresight_env.scenarios.episode_parameters import EpisodeParameters

HORIZON = 10


def begun(kind, gamma=(0.95, 0.9)):
    behaviour = kind(BehaviourSetting(lambda stages: crosswalk_game(2, stages), HORIZON, 50))
    behaviour.reset(
        EpisodeParameters(MONTE_CARLO.initial_state, MONTE_CARLO.theta, np.array(gamma))
    )
    return behaviour


def test_discount_factors_change_once_and_at_the_time():
    changing, usual = begun(ChangingGamma), begun(Receding)
    after = begun(Receding, (0.95, SHORT_SIGHT))
    states = MONTE_CARLO.initial_state
    for _ in range(round(CHANGE_TIME / 0.1)):
        np.testing.assert_allclose(changing.act(states), usual.act(states), atol=1e-6)
    expected = after.act(states)
    np.testing.assert_allclose(changing.act(states), expected, atol=1e-4)
    assert np.abs(expected - usual.act(states)).max() > 0.1
    assert SHORT_SIGHT < 0.9 < LONG_SIGHT


def test_who_ignores_the_ego_moves_as_if_it_were_alone():
    ignoring, usual = begun(IgnoringOthers), begun(Receding)
    # The ego stands in the other's way.
    states = np.array([[0.5, 1.5, 0.0, 0.0], [0.0, 2.0, 0.4, -0.4]])
    found, avoiding = ignoring.act(states), usual.act(states)
    alone = solve(
        crosswalk_game(1, HORIZON), [states[IGNORING]], [MONTE_CARLO.theta[IGNORING]], [0.9]
    )
    np.testing.assert_allclose(found[IGNORING], alone.controls[0][0], atol=1e-5)
    np.testing.assert_allclose(found[0], avoiding[0], atol=1e-9)
    assert np.abs(found[IGNORING] - avoiding[IGNORING]).max() > 0.1


def test_social_force_walkers_reach_their_goals_and_make_way():
    setting = RunSetting("crosswalk", players=3, surprise="social-force", noise_std=0.0)
    for seed in range(3):
        found = run_episode(setting, "constant-velocity", seed)
        goals = found.last["theta"]["goal"]
        begin = np.linalg.norm(found.states[0, :, :2] - goals, axis=1)
        end = np.linalg.norm(found.states[-1, :, :2] - goals, axis=1)
        assert (end < 0.6 * begin).all()
        others = found.states[:, 1, :2] - found.states[:, 2, :2]
        assert np.linalg.norm(others, axis=1).min() > 0.3
        speed = np.abs(found.states[..., 2:])
        assert speed.max() <= 0.8 + 1e-9


@pytest.mark.parametrize("width", [2, 4])
@pytest.mark.parametrize("name", ["dropouts", "outliers", "none"])
def test_sensors_change_what_is_seen_of_others_alone(name, width):
    random, changed = np.random.default_rng(0), []
    seen = np.arange(4.0 * width + 2.0)
    for _ in range(500):
        found = observed(name, random, seen, 4, 0.05)
        np.testing.assert_array_equal(found[:width], seen[:width])
        np.testing.assert_array_equal(found[-2:], seen[-2:])
        others = found[width:-2].reshape(3, width)
        whole = seen[width:-2].reshape(3, width)
        if name == "dropouts":
            missing = np.isnan(others)
            assert (missing.all(axis=1) == missing.any(axis=1)).all()
            changed.append(missing.all(axis=1).mean())
        else:
            assert (others[:, 2:] == whole[:, 2:]).all()
            changed.append((others[:, :2] != whole[:, :2]).any(axis=1).mean())
    expected = {"dropouts": 0.3, "outliers": 0.05, "none": 0.0}[name]
    assert np.mean(changed) == pytest.approx(expected, abs=0.02)


def test_what_cannot_occur_is_refused():
    with pytest.raises(ValueError, match="surprise: 'idm' does not occur in the scenario cross"):
        RunSetting("crosswalk", surprise="idm")
    with pytest.raises(ValueError, match="surprise: 'rain' is unknown; choose from none, gamma"):
        RunSetting("crosswalk", surprise="rain")


@pytest.mark.parametrize("name", SURPRISES)
def test_the_environment_of_every_surprise_can_be_made(name):
    # Environments of recordings are made by `evaluation.windows.replay`.
    for scenario in set(SURPRISES[name].scenarios) - {"recorded"}:
        assert RunSetting(scenario, surprise=name).make().scene.players > 1


def test_truths_that_do_not_last_are_not_shown():
    gamma = {"gamma": np.array([0.95, 0.5, 0.7])}
    for name, missing in (("none", 0), ("dropouts", 0), ("gamma-change", 2), ("social-force", 2)):
        assert np.isnan(RunSetting(surprise=name).true_gammas(gamma)).sum() == missing
    with pytest.raises(ValueError, match="surprise: 'gamma-change' has a behaviour; expected"):
        RunSetting(behaviour="open_loop", surprise="gamma-change")
