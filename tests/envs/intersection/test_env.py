"""Properties of the intersection alone: arguments, draws, ends, behaviours, pictures."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from agents.egos.oracle import Oracle
from foresight_env.envs import intersection_v0
from foresight_env.envs.core import behaviours as oracle
from foresight_env.envs.intersection.world import intersection_world
from foresight_env.envs.rendering.style import COLOURS
from foresight_env.equilibrium import Status, solve
from foresight_env.scenarios.aachen import AACHEN
from foresight_env.scenarios.junction import JunctionRanges, draw_junction, junction_game

CAR = "car_1"
COAST = {CAR: np.zeros(2, dtype=np.float32)}
# In the western arm: the car drives west, the pedestrian is behind it on the pavement's edge.
APART = np.array([[-18.4, 66.3, 0.0, 0.0], [-25.0, 63.0, 5.0, np.pi]])


def make(**arguments):
    settings = {"pedestrians": 1, "cars": 1, "planning_horizon": 6, "max_steps": 6}
    return intersection_v0.parallel_env(**{**settings, **arguments})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pedestrians", 0),
        ("pedestrians", 5),
        ("cars", 0),
        ("cars", 2.0),
        ("controlled", (2,)),
        ("controlled", "second car"),
        ("ranges", (0.3, 1.0)),
        ("ranges", JunctionRanges(along=5.0)),
        ("ranges", JunctionRanges(collision_weight=(0.0, 1.0))),
        ("noise_std", -1.0),
    ],
)
def test_wrong_arguments_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        make(**{name: value})


def test_agents_and_spaces_follow_the_kinds():
    env = make(pedestrians=2, cars=2, controlled="all")
    assert env.possible_agents == ["pedestrian_0", "pedestrian_1", "car_2", "car_3"]
    assert env.action_space("car_2").high == pytest.approx([5.0, np.pi / 4])
    assert env.action_space("pedestrian_0").high == pytest.approx([5.0, 5.0])
    high = env.observation_space("car_3").high
    assert high[2:4] == pytest.approx([25.0, 4.0 * np.pi])  # itself first
    assert high[6:8] == pytest.approx([6.0, 6.0])
    assert make().possible_agents == [CAR]
    assert len(make(controlled=None).possible_agents) == 2
    single = gymnasium.make("foresight/Intersection-v0", pedestrians=3, cars=1)
    assert single.unwrapped.scene.controlled == (3,)
    with pytest.raises(ValueError, match="controlled"):
        gymnasium.make("foresight/Intersection-v0", controlled=(0,))


@pytest.mark.parametrize("count", [(1, 4), (4, 1), (4, 4)])
def test_draws_at_the_limits_are_legal_and_around_the_published_situation(count):
    """No agent begins in another or off the road, whatever is drawn."""
    wide = JunctionRanges(along=3.0, place=1.0, speed=4.0, goal=10.0)
    world = intersection_world(*count, wide)
    for seed in range(60):
        drawn = draw_junction(np.random.default_rng(seed), *count, wide)
        still = np.zeros((sum(count), 2))
        assert (world.gaps(drawn.initial_state, still, drawn.initial_state) > 0.0).all()
        assert not world.off_road(drawn.initial_state).any()
        assert (drawn.initial_state[count[0] :, 2] > 0.0).all()
    near = draw_junction(np.random.default_rng(0), 2, 2)
    assert np.abs(near.initial_state[:, :2] - AACHEN.initial_state[:, :2]).max() <= 2.0
    with pytest.raises(ValueError, match="cars"):
        draw_junction(np.random.default_rng(0), 1, 5)


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("off the road", {1: [-21.5, 73.0, 5.0, 0.0]}),
        ("off the road", {1: [-30.0, 70.0, 5.0, 0.0]}),
        ("off the road", {0: [-21.5, 73.0, 0.0, 0.0]}),
        ("collision", {0: [-24.0, 63.5, 0.0, 0.0]}),
        ("car_1 has", {1: [-25.0, 63.0, -1.0, 0.0]}),
        ("car_1 has", {1: [-25.0, 63.0, 21.0, 0.0]}),
        ("pedestrian_0 has", {0: [-18.4, 66.3, 3.1, 0.0]}),
        ("outside", {0: [-100.0, 66.3, 0.0, 0.0]}),
    ],
)
def test_wrong_initial_states_are_named(message, change):
    states = APART.copy()
    for player, state in change.items():
        states[player] = state
    with pytest.raises(ValueError, match=message):
        make().reset(seed=0, options={"initial_state": states})


def test_a_situation_of_other_kinds_is_refused():
    drawn, people = (draw_junction(np.random.default_rng(0), n, 1) for n in (1, 2))
    with pytest.raises(ValueError, match=r"theta\[1\].*lane_weight"):
        make().reset(options={"episode_parameters": drawn._replace(theta=people.theta[:2])})


def drive(env, action, states, steps=6):
    env.reset(seed=0, options={"initial_state": states})
    for _ in range(steps):
        _, _, terminated, truncated, infos = env.step({CAR: np.asarray(action)})
        if not env.agents:
            break
    return terminated[CAR], truncated[CAR], infos[CAR]


def test_running_somebody_over_between_two_steps_is_a_collision():
    """The car jumps over the pedestrian within one step of 4.8 m."""
    states = np.array([[-18.6, 66.3, 0.0, 0.0], [-16.0, 66.3, 20.0, np.pi]])
    terminated, _, info = drive(make(max_steps=1), [0.0, 0.0], states, 1)
    assert terminated
    assert info["collision"]
    assert not info["is_success"]
    assert info["min_distance"] == pytest.approx(-0.9 - 0.25, abs=0.1)


def test_leaving_the_road_ends_the_episode():
    states = np.array([[-18.4, 66.3, 0.0, 0.0], [-25.0, 66.5, 8.0, 0.5 * np.pi]])
    terminated, _, info = drive(make(), [0.0, 0.0], states)
    assert terminated
    assert info["off_road"]
    assert not info["collision"]
    assert not info["is_success"]


def test_coming_by_its_goal_is_success_for_a_car():
    env = make()
    goals = np.array([[-18.0, 76.0], [-31.0, 63.0]])
    env.reset(seed=0, options={"initial_state": APART, "goals": goals})
    while env.agents:
        _, _, terminated, _, infos = env.step(COAST)
    assert terminated[CAR]
    assert infos[CAR]["is_success"]
    assert np.linalg.norm(infos[CAR]["state"][1, :2] - goals[1]) <= 3.0


def test_cars_do_not_reverse_and_pedestrians_may_touch():
    env = make(pedestrians=2, controlled="all")
    states = np.array([[-18.4, 66.3, 0.0, 0.0], [-18.3, 66.3, 0.0, 0.0], APART[1]])
    env.reset(seed=0, options={"initial_state": states})
    while env.agents:
        actions = {a: np.zeros(2) for a in env.agents}
        infos = env.step({**actions, "car_2": np.array([-5.0, 0.3])})[4]
    info = infos["pedestrian_0"]
    assert info["state"][2, 2] == 0.0
    assert info["controls"][2][0] == 0.0
    assert not info["collision"]
    assert info["min_distance"] > 4.0


def test_others_play_the_equilibrium_of_the_true_game():
    env = make()
    drawn = draw_junction(np.random.default_rng(4), 1, 1)
    env.reset(seed=0, options={"episode_parameters": drawn})
    solution = solve(junction_game(1, 1, 6), *drawn, throw=True)
    info = env.step(COAST)[4][CAR]
    assert info["solver_status"] == Status.SOLVED
    assert info["controls"][0] == pytest.approx(solution.controls[0][0], abs=1e-6)
    assert np.array_equal(info["controls"][1], [0.0, 0.0])


def test_without_any_plan_others_brake(monkeypatch):
    def fail(*arguments, **named):
        found = solve(*arguments, **named)
        return found._replace(status=np.array(Status.DIVERGED), residual=np.array(np.nan))

    monkeypatch.setattr(oracle, "solve", fail)
    env = make(controlled=(0,))
    env.reset(seed=0, options={"initial_state": APART})
    info = env.step({"pedestrian_0": np.zeros(2)})[4]["pedestrian_0"]
    assert info["controls"][1] == pytest.approx([-5.0, 0.0])
    assert info["solver_failures"] == 1


def test_the_oracle_ego_drives_here_too():
    env = make(pedestrians=1)
    observations, infos = env.reset(seed=1)
    policy = Oracle()
    memory = policy.init(env.scene, CAR)
    while env.agents:
        memory = policy.update(memory, observations[CAR], infos[CAR])
        decision, memory = policy.act(memory)
        assert not decision.plan_fallback
        observations, _, _, _, infos = env.step({CAR: decision.action})
    assert not infos[CAR]["collision"]
    assert not infos[CAR]["off_road"]


def test_pictures_show_everybody():
    env = make(pedestrians=4, cars=4, controlled="all", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()[:, :640].reshape(-1, 3).astype(int)
    for colour in COLOURS:
        assert (np.abs(picture - colour).sum(axis=1) < 12).any(), colour
    env.close()
