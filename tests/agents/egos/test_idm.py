"""The IDM ego keeps to its path and behind who is ahead on it."""

import numpy as np
import pytest

from agents import make_ego
from foresight_env.envs import crosswalk_v0, driving_v0


def driven(env, steps):
    policy = make_ego("idm")
    observations, infos = env.reset(seed=0)
    memory = policy.init(env.scene, "car_0")
    states = [infos["car_0"]["state"]]
    while env.agents and len(states) <= steps:
        memory = policy.update(memory, observations["car_0"], {})
        decision, memory = policy.act(memory)
        assert env.action_space("car_0").contains(decision.action)
        observations, _, _, _, infos = env.step({"car_0": decision.action})
        states.append(infos["car_0"]["state"])
    return np.stack(states), infos["car_0"]


def test_it_follows_its_path():
    env = driving_v0.parallel_env(scene="merge", cars=2, behaviour="idm", noise_std=0.0)
    states, info = driven(env, 40)
    assert len(states) > 30
    assert not info["off_road"]
    path = info["theta"]["path"][0][:, :2]
    away = np.linalg.norm(states[:, 0, None, :2] - path, axis=2).min(axis=1)
    assert away.max() < 2.0  # points lie 2 m apart
    assert states[:, 0, 2].mean() > 5.0


def test_it_brakes_for_a_crawling_leader():
    env = driving_v0.parallel_env(scene="merge", cars=2, behaviour="idm", noise_std=0.0)
    _, infos = env.reset(seed=0)
    start = infos["car_0"]["state"]
    path = infos["car_0"]["theta"]["path"][0]
    ahead = path[10 + np.argmin(np.linalg.norm(path[:, :2] - start[0, :2], axis=1))]
    policy, goal = make_ego("idm"), infos["car_0"]["theta"]["goal"][0]

    def acceleration(other):
        seen = np.concatenate([start[0], other, goal])
        memory = policy.update(policy.init(env.scene, "car_0"), seen, {})
        return policy.act(memory)[0].action[0]

    crawling = np.array([*ahead[:2], 2.0, ahead[2]])
    elsewhere = crawling + np.array([0.0, 400.0, 0.0, 0.0])
    assert acceleration(crawling) < acceleration(elsewhere) - 1.0


def test_people_have_no_path():
    env = crosswalk_v0.parallel_env(controlled=(0,))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="pedestrian_0 follows no path"):
        make_ego("idm").init(env.scene, "pedestrian_0")
