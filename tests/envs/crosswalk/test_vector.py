"""Many crosswalks at once are the same crosswalks; as pure functions they are, too."""

from functools import partial

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import foresight_env.envs  # noqa: F401  (registers the environments)
from foresight_env.envs.crosswalk import functional
from foresight_env.envs.crosswalk import world as crosswalk_world
from foresight_env.envs.crosswalk.functional import CrosswalkSetting
from foresight_env.envs.crosswalk.vector import CrosswalkVectorEnv
from foresight_env.envs.crosswalk.vector_oracle import padded
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT, DT, SPEED_LIMIT

ID = "foresight/Crosswalk-v0"
COUNT = 4
SHORT = {"planning_horizon": 6, "max_steps": 12}


def many(count=COUNT, **arguments):
    return CrosswalkVectorEnv(count, **{**SHORT, **arguments})


def one_by_one(count=COUNT, autoreset_mode="NextStep", **arguments):
    def make():
        return gymnasium.make(ID, disable_env_checker=True, **{**SHORT, **arguments})

    return SyncVectorEnv([make] * count, autoreset_mode=autoreset_mode)


def to_goal(observations, players=2, size=4):
    """Actions (float32) that walk to the goal and evade no agent."""
    away = observations[:, -2:] - observations[:, :2]
    speed = observations[:, 2:4] if size == 4 else 0.0 * away
    return np.clip(4.0 * away - 3.0 * speed, -CONTROL_LIMIT, CONTROL_LIMIT).astype(np.float32)


def assert_same(mine, theirs, exact=1e-9, path=""):
    if isinstance(mine, dict):
        # What the others plan is in the information of single environments alone.
        theirs = {name: v for name, v in theirs.items() if not name.lstrip("_").startswith("plan_")}
        assert mine.keys() == theirs.keys()
        for name in mine:
            # Of solves that ended at slightly different points: both are far below the tolerance.
            if name != "solver_residual":
                assert_same(mine[name], theirs[name], exact, f"{path}/{name}")
        return
    mine, theirs = np.asarray(mine), np.asarray(theirs)
    if mine.dtype == object:  # observations of those that ended
        assert [v is None for v in mine] == [v is None for v in theirs]
        for own, other in zip(mine, theirs, strict=True):
            if own is not None:
                assert_same(own, other, exact, path)
        return
    assert (mine.shape, mine.dtype) == (theirs.shape, theirs.dtype), path
    tolerance = max(exact, 1e-6) if mine.dtype == np.float32 else exact
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=tolerance, err_msg=path)


@pytest.mark.parametrize(
    "arguments",
    [
        {"behaviour": "open_loop"},
        {"behaviour": "receding"},
        {"behaviour": "receding", "players": 3, "observation": "positions"},
        {"behaviour": "open_loop", "proximity": "hard", "noise_std": 0.0},
        {"behaviour": "open_loop", "autoreset_mode": "SameStep"},
    ],
    ids=lambda a: "-".join(map(str, a.values())),
)
def test_the_same_episodes_as_one_by_one(arguments):
    """Through ends and new beginnings, everything that both return, to 1e-9."""
    size = 2 if arguments.get("observation") == "positions" else 4
    mine, theirs = many(**arguments), one_by_one(**arguments)
    seen, theirs_seen = mine.reset(seed=5), theirs.reset(seed=5)
    assert_same(seen[0], theirs_seen[0])
    assert_same(seen[1], theirs_seen[1])
    ends, observations = 0, seen[0]
    for _ in range(30):
        actions = to_goal(observations, size=size)
        mine_step, theirs_step = mine.step(actions), theirs.step(actions)
        for own, other in zip(mine_step, theirs_step, strict=True):
            assert_same(own, other)
        observations = mine_step[0]
        ends += int((mine_step[2] | mine_step[3]).sum())
    assert ends >= COUNT


def test_seeds_and_options():
    env = many()
    first, _ = env.reset(seed=[7, 8, 9, 7])
    np.testing.assert_array_equal(first[0], first[3])
    assert not np.array_equal(first[0], first[1])
    second, _ = env.reset(seed=7)
    np.testing.assert_array_equal(first[:3], second[:3])
    third, _ = env.reset()  # continues with all environments' stream
    assert not np.array_equal(second, third)
    _, infos = env.reset(seed=7, options={"gamma": [0.9, 0.4]})
    np.testing.assert_array_equal(infos["gamma"], [[0.9, 0.4]] * COUNT)
    for _ in range(14):
        _, _, _, _, infos = env.step(np.zeros((COUNT, 2), np.float32))
    assert not (infos["gamma"] == [0.9, 0.4]).any()  # options are for one episode


def test_what_is_returned_is_the_user_s():
    env = many(behaviour="open_loop")
    env.reset(seed=0)
    actions = np.ones((COUNT, 2), np.float32)
    first = env.step(actions)
    kept = [np.copy(v) for v in (*first[:4], first[4]["state"])]
    for value in (*first[:4], first[4]["state"], first[4]["theta"]["goal"]):
        value[...] = 0
    again = many(behaviour="open_loop")
    again.reset(seed=0)
    again.step(actions)
    for own, other in zip(env.step(actions)[:4], again.step(actions)[:4], strict=True):
        np.testing.assert_array_equal(own, other)
    assert kept[4].any()


def test_made_by_gymnasium():
    env = gymnasium.make_vec(
        ID, num_envs=3, vectorization_mode="vector_entry_point", players=3, noise_std=0.0
    )
    assert isinstance(env.unwrapped, CrosswalkVectorEnv)
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    single = gymnasium.make(ID, players=3)
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.observation_space.shape == (3, *single.observation_space.shape)


@pytest.mark.parametrize(
    ("told", "arguments"),
    [
        ("num_envs: is 0", {"num_envs": 0}),
        ("render_mode: is 'human'; many", {"render_mode": "human"}),
        ("behaviour: is a factory", {"behaviour": lambda setting: None}),
        ("behaviour: is 'idm'", {"behaviour": "idm"}),
        ("players: is 7", {"players": 7}),
        ("noise_std: is -1", {"noise_std": -1}),
        (
            "autoreset_mode: is 'never'; expected one of 'NextStep', 'Same",
            {"autoreset_mode": "never"},
        ),
    ],
)
def test_wrong_arguments(told, arguments):
    with pytest.raises(ValueError, match=told):
        CrosswalkVectorEnv(**{"num_envs": 2, **arguments})


def test_wrong_actions_change_nothing():
    env = many(behaviour="open_loop")
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((COUNT, 2)))
    env.reset(seed=1)
    good = np.full((COUNT, 2), 0.5, np.float32)
    for wrong, told in (
        (good[:2], r"actions: have shape \(2, 2\)"),
        (np.full((COUNT, 2), "x"), "expected numbers"),
        (np.where(np.eye(COUNT, 2) > 0, np.nan, 0.0), r"actions\[0\]: is .*nan"),
        (good * 100, r"actions\[0\]: is .*50"),
    ):
        with pytest.raises(ValueError, match=told):
            env.step(wrong)
    with pytest.raises(ValueError, match="seed: has 2 entries; expected 4"):
        env.reset(seed=[1, 2])
    other = many(behaviour="open_loop")
    other.reset(seed=1)
    np.testing.assert_array_equal(env.step(good)[0], other.step(good)[0])


PLACE, SPEED, PUSH = st.floats(-3, 3), st.floats(-0.8, 0.8), st.floats(-10, 10)


@settings(max_examples=50, deadline=None)
@example(
    np.array([[5.07085139e-05, 0.0], [0.0, 0.0], [0.0, 0.0]]),
    np.zeros((3, 2)),
    np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]]),
)
@given(
    arrays(float, (3, 2), elements=PLACE),
    arrays(float, (3, 2), elements=SPEED),
    arrays(float, (3, 2), elements=PUSH),
)
def test_the_closest_approach_is_that_of_the_environment(places, speeds, controls):
    before = np.concatenate([places, speeds], axis=1)
    after = before.copy()
    after[:, :2] += DT * speeds + 0.5 * DT**2 * controls
    after[:, 2:] += DT * controls
    with jax.enable_x64(True):
        found = np.asarray(functional.closest_approach(before, controls, after))
    wanted = crosswalk_world.closest_approach(before, controls, after)
    # Squares, which are what is minimised: the root of one that touches zero magnifies rounding.
    np.testing.assert_allclose(found**2, wanted**2, atol=1e-9)


@pytest.mark.parametrize("behaviour", ["open_loop", "receding"])
def test_pure_functions_under_jit_vmap_and_scan(behaviour):
    """Episodes drawn by JAX are those of the environment from the same situations."""
    setting = CrosswalkSetting(behaviour=behaviour, noise_std=0.0, **SHORT)
    steps = 5

    @jax.jit
    @partial(jax.vmap)
    def episode(key):
        episode_parameters = functional.draw(setting, key)

        def step(planned, _):
            seen = functional.observe(setting, planned.state, key)
            action = jnp.clip(4.0 * (seen[-2:] - seen[:2]) - 3.0 * seen[2:4], -10.0, 10.0)
            # As the environment takes them.
            action = action.astype(jnp.float32).astype(action.dtype)
            planned, outcome = functional.advance(setting, planned, action)
            return planned, (planned.state.states, outcome, action, planned.status)

        begun = functional.begin(setting, episode_parameters)
        return episode_parameters, jax.lax.scan(step, begun, None, steps)[1]

    with jax.enable_x64(True):
        found = episode(jax.random.split(jax.random.key(0), 2))
        situations, (states, outcome, actions, status) = jax.tree.map(np.asarray, found)
    assert (status == 0).all()
    env = gymnasium.make(ID, behaviour=behaviour, noise_std=0.0, **SHORT)
    for k in range(2):
        episode_parameters = jax.tree.map(lambda v, k=k: v[k], situations)
        env.reset(options={"episode_parameters": episode_parameters})
        for t in range(steps):
            _, reward, terminated, _, info = env.step(actions[k, t].astype(np.float32))
            np.testing.assert_allclose(info["state"], states[k, t], atol=1e-7)
            assert reward == pytest.approx(-outcome.cost[k, t, 0], abs=1e-6)
            assert terminated == outcome.terminated[k, t]


def test_draws_lie_in_their_ranges():
    setting = CrosswalkSetting(players=3)
    keys = jax.random.split(jax.random.key(1), 200)
    found = jax.vmap(partial(functional.draw, setting))(keys)
    low, high = setting.ranges.gamma
    assert low <= found.gamma.min() < low + 0.02
    assert high - 0.02 < found.gamma.max() <= high
    spread = found.initial_state[:, :, :2].max(axis=0) - found.initial_state[:, :, :2].min(axis=0)
    np.testing.assert_allclose(spread, 2.0 * setting.ranges.start, rtol=0.1)
    assert (found.initial_state[:, :, 2:] == 0.0).all()
    assert (np.abs(found.initial_state) < 10 * SPEED_LIMIT).all()


def test_few_sizes_are_compiled():
    assert [padded(n) for n in (1, 2, 4, 5, 16, 17, 1024)] == [1, 4, 4, 16, 16, 64, 1024]
