"""The safety filter: when it replaces an action, and what follows from that."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from agents.egos.perception import Perception
from agents.egos.reachable import clearances
from agents.egos.safety_filter import FilterMemory, SafetyFilter
from agents.interfaces.policy import Decision
from evaluation.rollout.episode import run_episode
from evaluation.rollout.setting import RunSetting
from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0
from foresight_env.envs.core.behaviours import SolverReport
from foresight_env.highway.likely_route import likely_path, likely_paths
from foresight_env.highway.scenes import SCENES


class Standing:
    """Others that never move."""

    report = SolverReport()
    planned = None

    def __init__(self, setting):
        self._size = 2

    def reset(self, episode_parameters):
        self._count = len(episode_parameters.gamma)

    def plan(self, states):
        return None

    def act(self, states):
        return np.zeros((self._count, self._size))


class Memory(NamedTuple):
    perception: Perception


class Reckless:
    """Heads for the first other agent as fast as it can."""

    name = "reckless"

    def init(self, scene, agent):
        return Memory(Perception(scene, scene.index(agent)))

    def update(self, memory, observation, info):
        return Memory(memory.perception.taking(observation, info))

    def act(self, memory):
        states = memory.perception.states()
        away = states[1][:2] - states[0][:2]
        wanted = 0.8 * away / np.abs(away).max()
        action = np.clip((wanted - states[0][2:]) / 0.1, -10.0, 10.0).astype(np.float32)
        return Decision(action), Memory(memory.perception.acted(action))


def walks(policy, seed, noise=0.0):
    env = crosswalk_v0.parallel_env(behaviour=Standing, max_steps=40, noise_std=noise)
    observations, infos = env.reset(seed=seed)
    agent, decisions, beliefs = env.agents[0], [], []
    memory = policy.init(env.scene, agent)
    while env.agents:
        memory = policy.update(memory, observations[agent], infos[agent])
        beliefs.append((memory, infos[agent]["state"][0]))
        decision, memory = policy.act(memory)
        assert env.action_space(agent).contains(decision.action)
        decisions.append(decision)
        observations, _, _, _, infos = env.step({agent: decision.action})
    return infos[agent], decisions, beliefs


@pytest.mark.parametrize("seed", range(3))
def test_it_keeps_a_reckless_walker_from_a_collision(seed):
    alone, _, _ = walks(Reckless(), seed)
    assert alone["collision"]
    last, decisions, _ = walks(SafetyFilter(Reckless()), seed, noise=0.02)
    assert not last["collision"]
    assert any(d.intervention for d in decisions)
    # Nothing is replaced while the other is far.
    assert not any(d.intervention for d in decisions[:5])


def test_the_filtered_policy_knows_what_was_done():
    """Its state estimate follows the action that was applied, not the one it chose."""
    _, decisions, beliefs = walks(SafetyFilter(Reckless()), 0)
    first = next(k for k, d in enumerate(decisions) if d.intervention)
    for memory, truth in beliefs[first : first + 4]:
        own = memory.policy.perception.own.mean
        np.testing.assert_allclose(own, truth, atol=1e-3)


def test_nothing_is_replaced_without_others_near():
    env = crosswalk_v0.parallel_env(behaviour=Standing, noise_std=0.0)
    observations, _ = env.reset(seed=0)
    scene = env.scene
    far = np.array(observations["pedestrian_0"])
    far[4:6] = 15.0, 15.0
    memory = FilterMemory(None, Perception(scene, 0).taking(far, {}))
    space, filter_ = env.action_space("pedestrian_0"), SafetyFilter(Reckless())
    for seed in range(20):
        space.seed(seed)
        decision = Decision(space.sample())
        assert filter_._filtered(memory.perception, decision, None)[0] is decision


def test_more_that_others_may_do_is_never_clearer():
    env = driving_v0.parallel_env(scene="roundabout", cars=4, behaviour="idm", noise_std=0.0)
    observations, _ = env.reset(seed=0)
    perception = Perception(env.scene, 0).taking(observations["car_0"], {})
    times = np.linspace(0.1, 2.0, 20)
    own = np.tile([*perception.states()[0][:2], perception.states()[0][3]], (1, 20, 1))
    last = None
    for acceleration in (0.0, 1.0, 2.0, 4.0):
        found = clearances(perception, own, times, acceleration)
        # More that the others may do is never clearer, as none is behind.
        assert last is None or (found.worst <= last + 1e-9).all()
        last = found.worst


def test_all_possible_routes_of_a_car_are_returned():
    """On the ring it may stay or leave; the best guess is one of these."""
    scene = SCENES["roundabout"]
    path = scene.paths[1]
    found = [
        len(likely_paths(scene, path[k - 3 : k + 1, :2], float(path[k, 2])))
        for k in range(25, 45, 4)
    ]
    assert max(found) > 1
    for k in (25, 35):
        track, heading = path[k - 3 : k + 1, :2], float(path[k, 2])
        assert likely_path(scene, track, heading) is likely_paths(scene, track, heading)[0]


class Racing:
    """Accelerates straight on, without a plan."""

    name = "racing"

    def init(self, scene, agent):
        return None

    def update(self, memory, observation, info):
        return None

    def act(self, memory):
        return Decision(np.array([5.0, 0.0], dtype=np.float32)), None


def races(policy):
    """Lane change: a slower car is 22 m ahead."""
    env = driving_v0.parallel_env(
        scene="lane_change", cars=2, behaviour=Standing, noise_std=0.0, max_steps=40
    )
    observations, infos = env.reset(seed=0)
    memory, agent, count = policy.init(env.scene, "car_0"), "car_0", 0
    while env.agents:
        memory = policy.update(memory, observations[agent], infos[agent])
        decision, memory = policy.act(memory)
        assert env.action_space(agent).contains(decision.action)
        count += decision.intervention
        observations, _, _, _, infos = env.step({agent: decision.action})
    return infos[agent], count


def test_it_keeps_a_racing_car_off_the_car_ahead():
    """The other keeps its speed; the racer has no plan and would drive into it."""
    assert races(Racing())[0]["collision"]
    last, count = races(SafetyFilter(Racing()))
    assert not last["collision"]
    assert not last["off_road"]
    assert count > 0


def test_a_car_behind_is_behind_an_ego_that_drives_alone():
    """Of a walker a state has no heading: no car is assumed to brake for it."""
    env = intersection_v0.parallel_env(controlled=(0,), noise_std=0.0, behaviour=Standing)
    observations, _ = env.reset(seed=0)
    perception = Perception(env.scene, 0).taking(observations[env.agents[0]], {})
    car = env.scene.players - 1
    times = np.linspace(0.1, 2.0, 20)
    walker = perception.states()[0]
    known = list(perception.known)
    # Straight towards the walker, from where a heading of 0 would be its back.
    known[car] = np.array([walker[0] - 8.0, walker[1], 6.0, 0.0])
    for j in range(1, car):
        known[j] = known[j] + [500.0, 500.0, 0.0, 0.0]
    perception = perception._replace(known=tuple(known))
    own = np.tile([*walker[:2], 0.0], (1, 20, 1))
    assert clearances(perception, own, times, 1.5).expected.min() < 0.0


def test_a_setting_without_the_filter_counts_no_interventions():
    """Seed 1012: constant-velocity planning collides there without it (two walkers)."""
    setting = RunSetting("crosswalk", players=2, others_gamma=(0.2, 1.0))
    plain = run_episode(replace(setting, safety_filter=False), "constant-velocity", 1012)
    assert plain.last["collision"]
    assert plain.counts["interventions"] == 0
    filtered = run_episode(setting, "constant-velocity", 1012)
    assert not filtered.last["collision"]
    assert filtered.counts["interventions"] > 0


def test_it_has_its_policys_name_and_refuses_other_memory():
    policy = SafetyFilter(Reckless())
    assert policy.name == "reckless"
    env = crosswalk_v0.parallel_env(behaviour=Standing)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"memory: is .*FilterMemory"):
        policy.act(policy.policy.init(env.scene, 0))
