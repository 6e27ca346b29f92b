"""Scenes: how they are found through wrappers, and which episode they belong to."""

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RescaleAction, TimeLimit

import foresight_env.envs
from foresight_env.envs import crosswalk_v0, scene_of
from foresight_env.envs.core.scene import Scene


def test_the_scene_is_found_through_wrappers():
    env = gymnasium.make("foresight/Crosswalk-v0", planning_horizon=4)
    wrapped = RescaleAction(TimeLimit(env, 3), np.float32(-1.0), np.float32(1.0))
    wrapped.reset(seed=0)
    assert isinstance(scene_of(wrapped), Scene)
    assert scene_of(wrapped) is env.unwrapped.scene
    parallel = crosswalk_v0.parallel_env(planning_horizon=4)
    assert scene_of(parallel) is parallel.scene
    assert foresight_env.envs.scene_of is scene_of


@pytest.mark.parametrize("wrong", [None, 3, "foresight/Crosswalk-v0"])
def test_what_has_no_scene_is_refused(wrong):
    with pytest.raises(ValueError, match="env: is"):
        scene_of(wrong)
    with pytest.raises(ValueError, match="env: is"):
        scene_of(gymnasium.make("CartPole-v1"))


def test_an_episode_is_known_by_the_agents_own_parameters():
    env = crosswalk_v0.parallel_env(controlled="all", planning_horizon=4)
    early = env.scene
    first, info = env.reset(seed=0)
    scene = env.scene
    for agent in env.agents:
        scene.check_episode(agent, first[agent], info[agent])
        scene.check_episode(agent, first[agent], {})
        early.check_episode(agent, first[agent], info[agent])  # of no episode yet
    with pytest.raises(ValueError, match="observation: goal"):
        scene.check_episode("pedestrian_0", first["pedestrian_1"], {})
    second, other = env.reset(seed=1)
    with pytest.raises(ValueError, match="another episode"):
        scene.check_episode("pedestrian_0", second["pedestrian_0"], other["pedestrian_0"])
    mixed = {**info["pedestrian_0"], "gamma": other["pedestrian_0"]["gamma"]}
    with pytest.raises(ValueError, match="info: gamma"):
        scene.check_episode("pedestrian_0", first["pedestrian_0"], mixed)
    theta = {**mixed["theta"], "control_weight": np.array([0.3, 0.1])}
    mixed = {**info["pedestrian_0"], "theta": theta}
    with pytest.raises(ValueError, match="control_weight"):
        scene.check_episode("pedestrian_0", first["pedestrian_0"], mixed)
    scene.check_episode("pedestrian_1", first["pedestrian_1"], mixed)  # its own is the same
