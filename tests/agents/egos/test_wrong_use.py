"""Egos that are used wrongly say how: other episodes, short observations, no memory."""

import numpy as np
import pytest

from agents import make_ego
from foresight_env.envs import driving_v0
from tests.support.small_crossings import crossing, ego

EGO = "pedestrian_0"
NAMES = ["oracle", "infer-gamma", "assume-gamma-1", "constant-velocity", "cloned", "ppo"]


def begun(name):
    """A policy and its memory at the first step of an episode."""
    env, policy = crossing(), ego(name)
    observations, infos = env.reset(seed=0)
    return env, policy, policy.init(env.scene, EGO), observations[EGO], infos[EGO]


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_of_an_earlier_episode_is_refused(name):
    env, policy, memory, observation, info = begun(name)
    policy.update(memory, observation, info)
    for options in (None, {"goals": np.array(info["theta"]["goal"]), "gamma": [0.31, 0.5]}):
        observations, infos = env.reset(seed=1, options=options)
        with pytest.raises(ValueError, match=r"another episode.*after reset"):
            policy.update(memory, observations[EGO], infos[EGO])
        policy.update(policy.init(env.scene, EGO), observations[EGO], infos[EGO])


@pytest.mark.parametrize("name", NAMES)
def test_the_goal_tells_another_episode_where_info_is_hidden(name):
    env, policy, memory, _, _ = begun(name)
    observations, infos = env.reset(seed=1)
    with pytest.raises(ValueError, match="observation: goal"):
        policy.update(memory, observations[EGO], {})
    with pytest.raises(ValueError, match="observation: goal"):
        policy.update(memory, observations[EGO], dict.fromkeys(infos[EGO]))


def test_the_idm_ego_is_told_as_well():
    """Goals of driving scenes are the same in every episode; target speeds are not."""
    env = driving_v0.parallel_env(scene="merge", cars=2, planning_horizon=4)
    env.reset(seed=0)
    policy = make_ego("idm")
    memory = policy.init(env.scene, "car_0")
    observations, infos = env.reset(seed=1)
    with pytest.raises(ValueError, match="another episode"):
        policy.update(memory, observations["car_0"], infos["car_0"])


@pytest.mark.parametrize("name", NAMES)
def test_an_observation_of_another_shape_is_named(name):
    _, policy, memory, observation, info = begun(name)
    for wrong in (observation[:-1], observation[:1], observation[None], None):
        with pytest.raises(ValueError, match=r"observation: has shape .*expected \(10,\)"):
            policy.update(memory, wrong, info)
    with pytest.raises(ValueError, match="info: is None"):
        policy.update(memory, observation, None)


@pytest.mark.parametrize("name", [*NAMES, "idm"])
def test_something_else_than_a_memory_is_named(name):
    policy = ego(name)
    for wrong in (None, {}, (policy, None)):
        with pytest.raises(ValueError, match="memory: is"):
            policy.act(wrong)
        with pytest.raises(ValueError, match="memory: is"):
            policy.update(wrong, np.zeros(10), {})


@pytest.mark.parametrize("name", NAMES)
def test_to_act_before_the_first_update_is_named(name):
    _, policy, memory, _, _ = begun(name)
    with pytest.raises(ValueError, match=r"memory: .*call update before act"):
        policy.act(memory)
