"""Settings by name."""

import numpy as np
import pytest

from evaluation.rollout.places import (
    DEVELOPMENT_SEEDS,
    SETTINGS,
    TEST_SEEDS,
    is_driving,
    setting_of,
)
from evaluation.rollout.setting import EGO_GAMMA, RunSetting
from evaluation.rollout.simulation import simulate
from foresight_env.names import PLACES


def test_published_places_are_as_they_were():
    assert setting_of("crosswalk") == RunSetting("crosswalk")
    assert setting_of("merge", "idm") == RunSetting("driving", scene="merge", behaviour="idm")
    assert set(PLACES) <= set(SETTINGS)
    assert is_driving("left_turn-4s")
    assert not is_driving("crowd-3-short")
    with pytest.raises(ValueError, match="'nowhere' is unknown; choose from crosswalk"):
        setting_of("nowhere")


def test_no_episode_is_both_for_development_and_for_tests():
    assert not set(DEVELOPMENT_SEEDS) & set(TEST_SEEDS)


@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_is_what_its_fields_say(name):
    setting = SETTINGS[name]
    env = setting.make()
    scene = env.scene
    if setting.players is not None:
        assert scene.players == setting.players
    if setting.planning_horizon is not None:
        assert scene.game.horizon == setting.planning_horizon
    if setting.scenario == "driving":
        usual = RunSetting("driving", setting.scene).make().scene
        assert scene.dt == pytest.approx(setting.step or usual.dt)
        # Episodes last as long, whatever the step.
        assert scene.max_steps * scene.dt == pytest.approx(usual.max_steps * usual.dt)


def test_discount_factors_are_drawn_from_the_setting_s_range():
    setting = SETTINGS["crowd-3-short"]
    found = simulate(setting.make(), 0, setting.gammas, np.zeros((1, 2)), limit=0.1).info["gamma"]
    assert found[0] == EGO_GAMMA
    assert ((found[1:] >= 0.2) & (found[1:] <= 0.7)).all()


def test_steps_differ_in_driving_alone():
    with pytest.raises(ValueError, match=r"step: is 0\.2"):
        RunSetting("crosswalk", step=0.2)
