"""The conformance suite and the frameworks' own checks over many configurations."""

from __future__ import annotations

import warnings
from functools import partial

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env

from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0
from tests.support import env_conformance as conformance

with warnings.catch_warnings():
    # PettingZoo's tests import its own environments in a way that it has deprecated itself.
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

SHORT = {"planning_horizon": 6, "max_steps": 10}


def single(**arguments):
    """The Gymnasium id, as a parallel environment."""
    return conformance.as_parallel(
        gymnasium.make("foresight/Crosswalk-v0", **{**SHORT, **arguments})
    )


MAKERS = [
    pytest.param(partial(crosswalk_v0.parallel_env, **SHORT, **arguments), id=name)
    for name, arguments in {
        "two-receding": {},
        "two-open-loop-positions": {"behaviour": "open_loop", "observation": "positions"},
        "two-all": {"controlled": "all"},
        "second-controlled": {"controlled": (1,), "observation": "positions"},
        "three-receding": {"players": 3, "observation": "positions"},
        "three-open-loop-two-controlled": {
            "players": 3,
            "controlled": (0, 2),
            "behaviour": "open_loop",
        },
        "three-all-positions": {"players": 3, "controlled": None, "observation": "positions"},
    }.items()
] + [
    pytest.param(single, id="gymnasium"),
    pytest.param(partial(single, behaviour="open_loop", players=3), id="gymnasium-three"),
]
# One horizon for both behaviours: they share a compiled game.
JUNCTION = {"pedestrians": 1, "cars": 1, "planning_horizon": 6, "max_steps": 6}


def single_junction(**arguments):
    """The intersection's Gymnasium id, as a parallel environment."""
    return conformance.as_parallel(
        gymnasium.make("foresight/Intersection-v0", **{**JUNCTION, **arguments})
    )


JUNCTION_MAKERS = [
    pytest.param(partial(intersection_v0.parallel_env, **{**JUNCTION, **arguments}), id=name)
    for name, arguments in {
        "car-receding": {},
        "pedestrian-open-loop-positions": {
            "controlled": (0,),
            "behaviour": "open_loop",
            "observation": "positions",
        },
        "eight-all": {"pedestrians": 4, "cars": 4, "controlled": "all"},
    }.items()
] + [pytest.param(single_junction, id="intersection-gymnasium")]


DRIVING = {"cars": 2, "planning_horizon": 4, "max_steps": 6}


def single_driving(**arguments):
    """The Gymnasium id of driving, as a parallel environment."""
    return conformance.as_parallel(
        gymnasium.make("foresight/Driving-v0", **{**DRIVING, **arguments})
    )


DRIVING_MAKERS = [
    pytest.param(partial(driving_v0.parallel_env, **{**DRIVING, **arguments}), id=name)
    for name, arguments in {
        "left-turn-receding": {},
        "merge-idm-positions": {"scene": "merge", "behaviour": "idm", "observation": "positions"},
        "roundabout-six-all": {"scene": "roundabout", "cars": 6, "controlled": "all"},
    }.items()
] + [pytest.param(partial(single_driving, scene="lane_change"), id="driving-gymnasium")]


def pairwise(makers, checks):
    """Every check on the first configuration of a scenario, and on every third of the others.

    Which third moves on from check to check, so that every configuration meets a third of them.
    """
    return [
        pytest.param(*maker.values, check, id=f"{maker.id}-{name}")
        for k, (name, check) in enumerate(checks)
        for place, maker in enumerate(makers)
        if place == 0 or place % 3 == k % 3
    ]


NAMED = [(check.__name__, check) for check in conformance.CHECKS]


@pytest.mark.parametrize(
    ("make", "check"),
    [
        case
        for makers in (MAKERS, JUNCTION_MAKERS, DRIVING_MAKERS)
        for case in pairwise(makers, NAMED)
    ],
)
def test_conformance(make, check):
    check(make)


def test_every_configuration_meets_a_third_of_the_checks():
    for makers in (MAKERS, JUNCTION_MAKERS, DRIVING_MAKERS):
        met = [case.values[0] for case in pairwise(makers, NAMED)]
        assert all(met.count(maker.values[0]) >= len(NAMED) // 3 for maker in makers)
        assert met.count(makers[0].values[0]) == len(NAMED)


@pytest.mark.parametrize("make", MAKERS)
def test_crosswalk_rewards(make):
    conformance.reward_is_minus_stage_cost(make, conformance.crosswalk_cost)


@pytest.mark.parametrize("make", JUNCTION_MAKERS)
def test_intersection_rewards(make):
    conformance.reward_is_minus_stage_cost(make, conformance.intersection_cost)


@pytest.mark.parametrize("make", DRIVING_MAKERS)
def test_driving_rewards(make):
    conformance.reward_is_minus_stage_cost(make, conformance.driving_cost)


@pytest.mark.parametrize("spoil", conformance.WRONG)
@pytest.mark.parametrize("make", [MAKERS[0], MAKERS[5], JUNCTION_MAKERS[0], DRIVING_MAKERS[1]])
def test_wrong_actions_change_nothing(make, spoil):
    conformance.wrong_actions_change_nothing(make, spoil)


@pytest.mark.parametrize(
    "make", [MAKERS[2], MAKERS[5], MAKERS[6], JUNCTION_MAKERS[1], DRIVING_MAKERS[1]]
)
def test_pettingzoo_accepts(make):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(make(), num_cycles=25)
        parallel_seed_test(make, num_cycles=25)


def test_pettingzoo_accepts_the_cycle_form():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        api_test(crosswalk_v0.env(players=3, controlled="all", **SHORT), num_cycles=30)
        # A car and a pedestrian see and do different things.
        warnings.filterwarnings("ignore", message="Agents have different .* space")
        api_test(intersection_v0.env(**{**JUNCTION, "controlled": "all"}), num_cycles=30)
        api_test(driving_v0.env(**{**DRIVING, "controlled": "all"}), num_cycles=30)
    assert crosswalk_v0.raw_env(**SHORT).possible_agents == ["pedestrian_0"]


def test_registered_in_pettingzoo():
    env = pettingzoo.make("parallel", "foresight/crosswalk-v0", players=3, controlled=(2,))
    assert isinstance(env, crosswalk_v0.parallel_env)
    assert env.possible_agents == ["pedestrian_2"]
    env = pettingzoo.make("parallel", "foresight/intersection-v0")
    assert isinstance(env, intersection_v0.parallel_env)
    assert env.possible_agents == ["car_2"]
    env = pettingzoo.make("parallel", "foresight/driving-v0", scene="merge")
    assert isinstance(env, driving_v0.parallel_env)
    assert env.possible_agents == ["car_0"]


@pytest.mark.parametrize("observation", ["full", "positions"])
def test_gymnasium_accepts(observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Advice for learners that take actions in [-1, 1]; ours are m/s^2, and users can rescale.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space")
        env = gymnasium.make("foresight/Crosswalk-v0", observation=observation, **SHORT)
        check_env(env.unwrapped, skip_render_check=True)
        env = gymnasium.make("foresight/Crosswalk-v0", render_mode="rgb_array", **SHORT)
        check_env(env.unwrapped)
        arguments = {**JUNCTION, "observation": observation, "render_mode": "rgb_array"}
        check_env(gymnasium.make("foresight/Intersection-v0", **arguments).unwrapped)
        arguments = {**DRIVING, "observation": observation, "render_mode": "rgb_array"}
        check_env(gymnasium.make("foresight/Driving-v0", **arguments).unwrapped)


def test_gymnasium_vectorises():
    envs = gymnasium.make_vec("foresight/Crosswalk-v0", num_envs=2, **SHORT)
    alone = single()
    observations, infos = envs.reset(seed=[3, 4])
    expected, _ = alone.reset(seed=4)
    assert np.array_equal(observations[1], expected["pedestrian_0"])
    assert infos["state"].shape == (2, 2, 4)
    for _ in range(12):  # beyond the end: the vector environment resets by itself
        observations, rewards, _, _, infos = envs.step(np.ones((2, 2), dtype=np.float32))
        assert observations.shape == (2, 10)
        assert np.isfinite(rewards).all()
    envs.close()
