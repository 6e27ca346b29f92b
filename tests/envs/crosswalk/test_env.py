"""Properties of the crosswalk alone: arguments, options, motion, ends, behaviours."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from foresight_env.envs import crosswalk_v0
from foresight_env.envs.core import behaviours as oracle
from foresight_env.envs.core.motion import applicable
from foresight_env.envs.crosswalk.world import closest_approach
from foresight_env.equilibrium import Status, solve
from foresight_env.scenarios.crosswalk import Ranges, crosswalk_game, draw_crossing
from foresight_env.scenarios.episode_parameters import EpisodeParameters
from tests.support import env_conformance as conformance

EGO = "pedestrian_0"
STILL = {EGO: np.zeros(2, dtype=np.float32)}


def make(**arguments):
    return crosswalk_v0.parallel_env(**{"planning_horizon": 6, "max_steps": 10, **arguments})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("players", 1),
        ("players", 7),
        ("players", 2.5),
        ("players", True),
        ("controlled", ()),
        ("controlled", (0, 0)),
        ("controlled", (2,)),
        ("controlled", 0),
        ("controlled", "some"),
        ("behaviour", "polite"),
        ("behaviour", None),
        ("observation", "camera"),
        ("noise_std", -0.1),
        ("noise_std", np.nan),
        ("noise_std", "small"),
        ("proximity", "firm"),
        ("ranges", (0.3, 1.0)),
        ("ranges", Ranges(gamma=(1.0, 0.3))),
        ("ranges", Ranges(start=2.0)),
        ("ranges", Ranges(goal=-1.0)),
        ("ranges", Ranges(control_weight=(0.0, 1.0))),
        ("planning_horizon", 0),
        ("max_steps", 0),
        ("render_mode", "ascii"),
    ],
)
def test_wrong_arguments_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        make(**{name: value})


def test_agents_are_the_controlled_ones():
    assert make(players=4, controlled=(3, 1)).possible_agents == ["pedestrian_1", "pedestrian_3"]
    assert len(make(players=6, controlled=None).possible_agents) == 6
    with pytest.raises(ValueError, match="pedestrian_1"):
        make().observation_space("pedestrian_1")
    with pytest.raises(ValueError, match="controlled"):
        gymnasium.make("foresight/Crosswalk-v0", controlled=(0,))


def overlapping():
    states = np.zeros((2, 4))
    states[1, 0] = 0.4
    return states


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma", [0.5]),
        ("gamma", [0.5, -0.1]),
        ("gamma", [0.5, np.inf]),
        ("gamma", "low"),
        ("goals", np.zeros((2, 3))),
        ("goals", np.full((2, 2), 50.0)),
        ("initial_state", np.zeros(8)),
        ("initial_state", np.array([[0.0, 0, 0.9, 0], [2.0, 0, 0, 0]])),
        ("initial_state", overlapping()),
        ("episode_parameters", 3),
        ("episode_parameters", draw_crossing(np.random.default_rng(0), 3)),
        ("episode_parameters", draw_crossing(np.random.default_rng(0), 2)._replace(theta=({}, {}))),
        ("speed", 1.0),
    ],
)
def test_wrong_options_are_named_and_change_nothing(name, value):
    env, untouched = make(), make()
    first = env.reset(seed=0)
    assert conformance.identical(first, untouched.reset(seed=0))
    with pytest.raises(ValueError, match=name):
        env.reset(options={name: value})
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)
    assert conformance.identical(env.step(STILL), untouched.step(STILL))
    assert conformance.identical(env.reset(), untouched.reset())


def test_options_replace_what_would_be_drawn():
    env = make(noise_std=0.0)
    episode_parameters = draw_crossing(
        np.random.default_rng(3), 2, Ranges(control_weight=(0.2, 0.3))
    )
    gamma = np.array([0.4, 1.2])
    observations, infos = env.reset(
        seed=0, options={"episode_parameters": episode_parameters, "gamma": gamma}
    )
    info = infos[EGO]
    assert np.array_equal(info["gamma"], gamma)
    assert np.array_equal(info["state"], episode_parameters.initial_state)
    assert info["theta"]["control_weight"][1] == episode_parameters.theta[1]["control_weight"]
    assert np.array_equal(
        observations[EGO][:4], episode_parameters.initial_state[0].astype(np.float32)
    )
    # The draws of the next episode are those of an environment that was given no options.
    other = make(noise_std=0.0)
    other.reset(seed=0)
    assert conformance.identical(env.reset(), other.reset())


values = st.one_of(
    st.none(),
    st.text(max_size=3),
    st.floats(),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=2), st.floats(), max_size=2),
    arrays.arrays(np.float64, arrays.array_shapes(max_dims=3, max_side=3)),
    arrays.arrays(np.complex128, (2,)),
    arrays.arrays(np.bool_, (2,)),
)


def is_legal(value, shape, most):
    try:
        array = np.array(value)
    except ValueError:
        return False
    return (
        array.dtype.kind in "fiu" and array.shape == shape and bool((np.abs(array) <= most).all())
    )


@settings(max_examples=150, deadline=None)
@given(values)
def test_malformed_actions_raise_value_error(action):
    env = make(controlled="all", max_steps=2)
    _, infos = env.reset(seed=0)
    actions = {EGO: action, "pedestrian_1": np.zeros(2)}
    if is_legal(action, (2,), 10.0):
        env.step(actions)
        return
    with pytest.raises(ValueError, match=r"actions\['pedestrian_0'\]"):
        env.step(actions)
    _, _, _, _, after = env.step({EGO: np.zeros(2), "pedestrian_1": np.zeros(2)})
    assert np.array_equal(after[EGO]["state"], infos[EGO]["state"])
    assert after[EGO]["time"] == pytest.approx(0.1)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["gamma", "goals", "initial_state", "episode_parameters", "other"]), values)
def test_malformed_options_raise_value_error(name, value):
    env = make(controlled="all")
    legal = (name == "gamma" and is_legal(value, (2,), 1e300) and (np.array(value) >= 0).all()) or (
        name == "goals" and is_legal(value, (2, 2), 20.0)
    )
    if legal:
        env.reset(seed=0, options={name: value})
        return
    with pytest.raises(ValueError, match=name):
        env.reset(seed=0, options={name: value})


def test_pettingzoo_probe_is_the_only_unknown_option():
    env = make()
    env.reset(options={"options": 1})
    for options in ({"options": 2}, {"options": 1, "seed": 0}, {"options": True}, [1]):
        with pytest.raises(ValueError, match="options"):
            env.reset(options=options)


def test_velocity_saturates_through_the_applied_control():
    env = make(controlled="all", max_steps=5)
    env.reset(seed=0)
    for _ in range(3):
        _, _, _, _, infos = env.step({a: np.array([10.0, -6.0]) for a in env.agents})
    info = infos[EGO]
    assert np.allclose(info["state"][:, 2:], [0.8, -0.8], atol=1e-15)
    assert np.abs(info["applied_action"]).max() < 1e-12


@settings(max_examples=100, deadline=None)
@given(arrays.arrays(np.float64, (2, 4), elements=st.floats(-0.8, 0.8)), st.integers(0, 99))
def test_closest_approach_is_that_of_fine_sampling(states, seed):
    controls = applicable(
        crosswalk_game(2, 6), states, np.random.default_rng(seed).uniform(-10, 10, (2, 2))
    )
    after = states.copy()
    after[:, :2] += 0.1 * states[:, 2:] + 0.5 * 0.01 * controls
    exact = closest_approach(states, controls, after)[0, 1]
    s = np.linspace(0.0, 0.1, 2001)[:, None]
    path = states[:, None, :2] + s * states[:, None, 2:] + 0.5 * s**2 * controls[:, None]
    sampled = np.linalg.norm(path[0] - path[1], axis=1).min()
    assert exact <= sampled + 1e-12
    # Between samples, 5e-5 s apart, the distance changes by no more than the relative speed allows.
    assert exact >= sampled - 1e-4


def test_collision_inside_a_step_ends_the_episode():
    """At both ends of the step the discs do not overlap; the acceleration brings them together."""
    env = make(controlled="all", max_steps=1)
    states = np.array([[0.0, 0.0, 0.8, 0.0], [0.562, 0.0, -0.8, 0.0]])
    goals = np.array([[5.0, 5.0], [-5.0, 5.0]])
    env.reset(seed=0, options={"initial_state": states, "goals": goals})
    push = {EGO: np.array([-10.0, 0.0]), "pedestrian_1": np.array([10.0, 0.0])}
    _, _, terminated, truncated, infos = env.step(push)
    gap = np.linalg.norm(np.diff(infos[EGO]["state"][:, :2], axis=0))
    assert gap > 0.5
    assert infos[EGO]["collision"]
    assert infos[EGO]["min_distance"] < 0.0
    # Checked before time-out: max_steps is 1.
    assert terminated[EGO]
    assert not truncated[EGO]


def test_goal_is_latched_and_all_must_reach_theirs():
    env = make(controlled="all", max_steps=60)
    states = np.array([[0.0, 0.0, 0.8, 0.0], [5.0, 0.0, 0.0, 0.0]])
    goals = np.array([[0.1, 0.0], [5.0, 0.8]])
    env.reset(seed=0, options={"initial_state": states, "goals": goals})
    while env.agents:
        actions = {EGO: np.array([0.0, 0.0]), "pedestrian_1": np.array([0.0, 2.0])}
        _, _, terminated, _, infos = env.step(actions)
        assert infos[EGO]["goal_reached"]
    assert np.linalg.norm(infos[EGO]["state"][0, :2] - goals[0]) > 0.25
    assert terminated[EGO]
    assert terminated["pedestrian_1"]
    assert infos["pedestrian_1"]["is_success"]


def test_collision_among_the_others_does_not_end_the_episode():
    class Towards:
        report, planned = oracle.SolverReport(), None

        def __init__(self, setting):
            assert setting.players == 3

        def reset(self, episode_parameters):
            self.episode_parameters = episode_parameters

        def plan(self, states):
            return None

        def act(self, states):
            return np.array([[0.0, 0.0], [5.0, 0.0], [-5.0, 0.0]])

    env = make(players=3, behaviour=Towards)
    states = np.array([[5.0, 5, 0, 0], [0.0, 0, 0, 0], [0.6, 0, 0, 0]])
    env.reset(seed=0, options={"initial_state": states})
    for _ in range(3):
        _, _, terminated, _, infos = env.step(STILL)
    gap = np.linalg.norm(infos[EGO]["state"][1, :2] - infos[EGO]["state"][2, :2])
    assert gap < 0.5
    assert not terminated[EGO]
    assert not infos[EGO]["collision"]
    assert infos[EGO]["solver_status"] == oracle.NOTHING_SOLVED


def test_behaviour_that_answers_nonsense_is_refused():
    class Broken(oracle.Receding):
        def act(self, states):
            return np.full((2, 2), np.nan)

    env = make(behaviour=Broken)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="behaviour"):
        env.step(STILL)


def test_receding_others_play_the_equilibrium_of_the_true_game():
    env = make()
    env.reset(seed=2)
    own = env.scene.own(EGO)
    _, infos = env.reset(seed=2)
    info = infos[EGO]
    theta = [{name: value[i] for name, value in info["theta"].items()} for i in range(2)]
    assert own.theta["goal"] == pytest.approx(theta[0]["goal"])
    for _ in range(3):
        solution = solve(crosswalk_game(2, 6), info["state"], theta, info["gamma"])
        info = env.step(STILL)[4][EGO]
        assert info["solver_status"] == Status.SOLVED
        assert info["solver_residual"] < 1e-8
        assert info["controls"][1] == pytest.approx(solution.controls[1][0], abs=1e-5)
        assert np.array_equal(info["controls"][0], [0.0, 0.0])


def test_open_loop_others_follow_one_plan():
    env = make(behaviour="open_loop")
    info = env.reset(seed=2)[1][EGO]
    theta = [{name: value[i] for name, value in info["theta"].items()} for i in range(2)]
    solution = solve(crosswalk_game(2, 10), info["state"], theta, info["gamma"])
    for step in range(1, 11):
        info = env.step({EGO: solution.controls[0][step - 1].clip(-10, 10)})[4][EGO]
        assert info["state"] == pytest.approx(
            np.stack([states[step] for states in solution.states]), abs=1e-9
        )
    assert env.agents == []


@pytest.mark.parametrize("behaviour", ["receding", "open_loop"])
def test_information_has_the_plan_that_the_others_follow_next(behaviour):
    env = make(behaviour=behaviour)
    info = env.reset(seed=2)[1][EGO]
    assert info["solver_status"] == oracle.NOTHING_SOLVED
    while env.agents:
        plan, before = info["plan_controls"], info["plan_states"]
        assert info["plan_stages"] == 6
        assert info["plan_solved"]
        np.testing.assert_allclose(before[:, 0], info["state"], atol=1e-6)
        # An ego that plays its part of it moves all agents as planned.
        info = env.step({EGO: plan[0, 0].astype(np.float32).clip(-10, 10)})[4][EGO]
        np.testing.assert_allclose(info["controls"], plan[:, 0], atol=1e-6)
        np.testing.assert_allclose(info["state"], before[:, 1], atol=1e-6)
    assert info["plan_stages"] == 0
    assert not info["plan_solved"]
    assert not info["plan_controls"].any()
    assert not info["plan_states"].any()
    # The same shapes throughout, also where the plan reaches to the episode's end.
    assert (plan.shape, before.shape) == ((2, 6, 2), (2, 7, 4))
    assert info["plan_controls"].shape == plan.shape
    assert info["plan_states"].shape == before.shape


def test_a_plan_that_ends_before_the_horizon_is_shown_as_far_as_it_goes():
    info = make(behaviour="open_loop", max_steps=4).reset(seed=2)[1][EGO]
    assert info["plan_stages"] == 4
    assert info["plan_controls"][:, :4].any(axis=(0, 2)).all()
    assert not info["plan_controls"][:, 4:].any()
    assert not info["plan_states"][:, 5:].any()


@pytest.mark.parametrize("behaviour", ["receding", "open_loop"])
def test_without_any_plan_others_brake_to_rest(behaviour, monkeypatch):
    def fail(*arguments, **named):
        found = solve(*arguments, **named)
        return found._replace(status=np.array(Status.DIVERGED), residual=np.array(np.nan))

    monkeypatch.setattr(oracle, "solve", fail)
    env = make(behaviour=behaviour)
    states = np.array([[0.0, 0, 0, 0], [3.0, 0, 0.5, -0.8]])
    env.reset(seed=0, options={"initial_state": states})
    for _ in range(2):
        info = env.step(STILL)[4][EGO]
        assert np.abs(info["state"][1, 2:]).max() < 1e-12
    assert info["solver_status"] == Status.DIVERGED
    assert info["solver_residual"] == np.inf
    assert info["solver_failures"] == (2 if behaviour == "receding" else 1)
    assert env.reset()[1][EGO]["solver_failures"] == 0


def test_a_failed_solve_keeps_the_shifted_plan(monkeypatch):
    env = make()
    plans = []

    def sometimes(*arguments, **named):
        found = solve(*arguments, **named)
        plans.append(found)
        return found if len(plans) == 1 else found._replace(status=np.array(Status.INFEASIBLE))

    monkeypatch.setattr(oracle, "solve", sometimes)
    assert env.reset(seed=1)[1][EGO]["plan_solved"]
    for step in range(3):
        info = env.step(STILL)[4][EGO]
        assert info["plan_stages"]
        assert not info["plan_solved"]
        assert info["controls"][1] == pytest.approx(plans[0].controls[1][step], abs=1e-7)
        assert info["solver_failures"] == step


def test_nothing_is_solved_when_everybody_is_controlled(monkeypatch):
    monkeypatch.setattr(oracle, "solve", None)
    for row in conformance.episode(make(controlled="all"), 0)[1:]:
        assert row[5][EGO]["solver_status"] == oracle.NOTHING_SOLVED


@pytest.mark.parametrize("proximity", ["hard", "reference"])
def test_other_proximities_are_played(proximity):
    env = make(proximity=proximity)
    for row in conformance.episode(env, 0)[1:]:
        info, reward = row[5][EGO], row[2][EGO]
        gap = np.linalg.norm(np.diff(info["state"][:, :2], axis=0))
        theta, place = info["theta"], info["state"][0, :2]
        cost = np.sum((place - theta["goal"][0]) ** 2) + 0.1 * np.sum(info["controls"][0] ** 2)
        hinge = 5.0 * max(0.0, 1.2 - gap) ** 2 if proximity == "reference" else 0.0
        assert reward == pytest.approx(-cost - hinge, rel=1e-9)


def test_scene_tells_what_a_policy_may_know():
    env = make(players=3, controlled=(1,), noise_std=0.02)
    scene = env.scene
    assert (scene.players, scene.controlled, scene.max_steps) == (3, (1,), 10)
    assert (scene.dt, scene.noise_std, scene.game.horizon) == (0.1, 0.02, 6)
    assert scene.observation_model("pedestrian_1").owners[::4] == (1, 0, 2)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"take env\.scene again"):
        scene.own("pedestrian_1")
    _, infos = env.reset(seed=0)
    assert env.scene.own(1).gamma == infos["pedestrian_1"]["gamma"][1]
    for other in (0, EGO, "nobody"):
        with pytest.raises(ValueError, match="not controlled"):
            env.scene.own(other)


def test_a_situation_can_be_played_again():
    episode_parameters = draw_crossing(np.random.default_rng(8), 2)
    assert isinstance(episode_parameters, EpisodeParameters)
    env = make()
    first, second = (
        conformance.episode(env, s, {"episode_parameters": episode_parameters}) for s in (0, 1)
    )
    assert np.array_equal(first[0][1][EGO]["state"], second[0][1][EGO]["state"])
    assert not np.array_equal(first[0][0][EGO], second[0][0][EGO])  # noise is the seed's


def test_import_is_light_and_changes_no_configuration():
    """Registering needs no JAX, and Gymnasium imports the package when an id names it."""
    code = (
        "import sys, gymnasium\n"
        "import foresight_env.envs as envs\n"
        "assert 'jax' not in sys.modules and 'pygame' not in sys.modules\n"
        "envs.register()\n"
        "assert 'foresight/Crosswalk-v0' in gymnasium.registry\n"
        "assert envs.crosswalk_v0.parallel_env().possible_agents == ['pedestrian_0']\n"
        "gymnasium.make('foresight_env.envs:foresight/Crosswalk-v0')\n"
        "import jax\n"
        "assert not jax.config.jax_enable_x64 and 'pygame' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", code], check=True)
