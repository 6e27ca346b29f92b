"""Every registered ego drives; what it decides, remembers, and does when a solve fails."""

from collections.abc import Mapping

import numpy as np
import pytest

import agents.egos.hypotheses
import agents.egos.planning
from agents import EGOS, Decision, InferGamma, Oracle, constant_velocity, make_ego
from agents.egos.planning import LOOK_AHEAD
from foresight_env.equilibrium import Status
from foresight_env.games import inside_bounds
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT, DT, SPEED_LIMIT, crosswalk_game
from tests.support.small_crossings import HORIZON, STEPS, crossing, drive, ego

EGO = "pedestrian_0"
BLIND = [name for name in EGOS if name != "oracle"]


class OwnEntry:
    """Entries of `info` of every player: only that of player 0 may be looked at."""

    def __init__(self, values):
        self.values = values

    def __getitem__(self, player):
        if player != 0:
            raise AssertionError(f"looked at player {player!r}")
        return self.values[player]


class Poison(Mapping):
    """An `info` of which an agent may read no more than its own parameters and last action."""

    def __init__(self, info):
        own = {name: OwnEntry(values) for name, values in info["theta"].items()}
        self.own = {
            "gamma": OwnEntry(info["gamma"]),
            "theta": own,
            "applied_action": info["applied_action"],
        }

    def __getitem__(self, key):
        if key not in self.own:
            raise AssertionError(f"looked at {key!r}")
        return self.own[key]

    def __iter__(self):
        return iter(("state", *self.own))

    def __len__(self):
        return 1 + len(self.own)


def same(one: Decision, other: Decision) -> bool:
    """Bitwise."""

    def bits(value):
        return None if value is None else (value.dtype, value.shape, value.tobytes())

    return (
        bits(one.action) == bits(other.action)
        and bits(one.planned) == bits(other.planned)
        and {j: bits(p) for j, p in one.predicted.items()}
        == {j: bits(p) for j, p in other.predicted.items()}
        and one.gammas == other.gammas
        and one.plan_fallback == other.plan_fallback
    )


def watched(policy, seen):
    """Decisions of a crossing in which the other pedestrian is seen at these steps only."""
    env = crossing()
    observations, infos = env.reset(seed=0)
    memory, decisions = policy.init(env.scene, EGO), []
    while env.agents:
        observation = observations[EGO].astype(float)
        if len(decisions) not in seen:
            observation[4:8] = np.nan
        memory = policy.update(memory, observation, infos[EGO])
        decision, memory = policy.act(memory)
        decisions.append(decision)
        assert env.action_space(EGO).contains(decision.action)
        observations, _, _, _, infos = env.step({EGO: decision.action})
    return decisions


@pytest.mark.parametrize(
    "name", ["constant-velocity", "kalman+plan", "infer-gamma", "cloned", "ppo"]
)
def test_somebody_is_out_of_sight(name):
    """Beyond all that is remembered, seen late, or never."""
    assert not any(d.plan_fallback for d in watched(ego(name), {0, 1}))
    late = watched(ego(name), range(2, STEPS))
    never = watched(ego(name), set())
    assert [d.plan_fallback for d in late] == [k < 2 for k in range(STEPS)]
    assert all(d.plan_fallback for d in never)


@pytest.mark.parametrize("name", EGOS)
def test_it_drives(name):
    decisions, infos = drive({EGO: ego(name)})
    assert len(decisions) == STEPS
    space = crossing().action_space(EGO)
    for step, info in zip(decisions, infos, strict=True):
        decision, state = step[EGO], info[EGO]["state"]
        assert space.contains(decision.action)  # finite, in bounds, float32
        assert not decision.plan_fallback
        # Plans of games with a short horizon are longer, but for the oracle's.
        stages = HORIZON if name == "oracle" else round(LOOK_AHEAD / DT)
        assert decision.planned.shape == (stages, 2)
        assert np.isfinite(decision.planned).all()
        # The plan begins where the agent is, as far as noise lets it know.
        reach = SPEED_LIMIT * DT + 5 * 0.02 + 0.05 * (name != "oracle")
        assert (np.abs(decision.planned[0] - state[0, :2]) < reach).all()
        assert set(decision.predicted) <= {1}
        for path in decision.predicted.values():
            assert path.shape == (stages, 2)
            assert np.isfinite(path).all()
        assert set(decision.gammas) <= {1}
        for mean, deviation in decision.gammas.values():
            assert 0.0 <= mean <= 1.5
            assert deviation >= 0.0
    last, truth = decisions[-1][EGO], infos[-1][EGO]
    assert set(last.predicted) == {1}
    told = {
        "oracle": {1: (truth["gamma"][1], 0.0)},
        "assume-gamma-1": {1: (1.0, 0.0)},
        "constant-velocity": {},
    }
    if name == "infer-gamma":
        assert last.gammas[1][1] > 0.0
        assert last.gammas[1] != decisions[2][EGO].gammas[1]
    else:
        assert last.gammas == told[name]
    # It gets going: the goal is two metres away.
    assert np.linalg.norm(infos[-1][EGO]["state"][0, 2:]) > 0.2


@pytest.mark.parametrize("name", EGOS)
def test_the_same_seed_gives_the_same_decisions(name):
    first, _ = drive({EGO: ego(name)}, seed=5)
    second, _ = drive({EGO: ego(name)}, seed=5)
    assert all(same(a[EGO], b[EGO]) for a, b in zip(first, second, strict=True))
    other, _ = drive({EGO: ego(name)}, seed=6)
    assert not all(same(a[EGO], b[EGO]) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("name", EGOS)
def test_one_policy_drives_two_agents(name):
    shared = ego(name)
    names = ("pedestrian_0", "pedestrian_1")
    together, infos = drive(dict.fromkeys(names, shared), controlled="all")
    apart, _ = drive({n: ego(name) for n in names}, controlled="all")
    for one, other in zip(together, apart, strict=True):
        assert all(same(one[n], other[n]) for n in names)
    assert set(together[-1]["pedestrian_1"].predicted) == {0}
    planned = together[-1]["pedestrian_1"].planned[0]
    assert np.abs(planned - infos[-1]["pedestrian_1"]["state"][1, :2]).max() < 0.3


@pytest.mark.parametrize("name", BLIND)
def test_only_the_oracle_looks_at_the_truth(name):
    told, _ = drive({EGO: ego(name)})
    untold, _ = drive({EGO: ego(name)}, poison=Poison)
    assert all(same(a[EGO], b[EGO]) for a, b in zip(told, untold, strict=True))


def alone(info):
    """An `info` of others that make no joint plan."""
    return {**info, "plan_stages": 0}


def test_the_oracle_plays_its_part_of_the_plan_that_the_others_follow():
    env = crossing()
    observations, infos = env.reset(seed=1)
    policy = Oracle()
    memory = policy.init(env.scene, EGO)
    while env.agents:
        plan, expected = infos[EGO]["plan_controls"], infos[EGO]["plan_states"]
        memory = policy.update(memory, observations[EGO], infos[EGO])
        decision, memory = policy.act(memory)
        np.testing.assert_array_equal(decision.action, np.float32(plan[0, 0]))
        np.testing.assert_array_equal(decision.planned, expected[0, 1:, :2])
        np.testing.assert_array_equal(decision.predicted[1], expected[1, 1:, :2])
        observations, _, _, _, infos = env.step({EGO: decision.action})
        np.testing.assert_allclose(infos[EGO]["state"], expected[:, 1], atol=1e-6)


def test_the_oracle_says_that_the_others_plan_is_an_earlier_one():
    env = crossing()
    observations, infos = env.reset(seed=1)
    policy = Oracle()
    for solved in (True, False):
        info = {**infos[EGO], "plan_solved": solved}
        memory = policy.update(policy.init(env.scene, EGO), observations[EGO], info)
        assert policy.act(memory)[0].plan_fallback == (not solved)


def test_an_ego_that_knows_gamma_infers_all_but_that():
    known, infos = drive({EGO: ego("know-gamma")})
    assert known[-1][EGO].gammas[1] == (infos[-1][EGO]["gamma"][1], 0.0)
    assumed, _ = drive({EGO: ego("assume-gamma-1")})
    assert not same(known[-1][EGO], assumed[-1][EGO])
    with pytest.raises(ValueError, match="'gamma'; know-gamma needs"):
        drive({EGO: ego("know-gamma")}, poison=lambda info: {})
    with pytest.raises(ValueError, match="true_gamma: is True with infer_gamma"):
        InferGamma(true_gamma=True)


def test_the_oracle_needs_the_truth():
    with pytest.raises(AssertionError, match="looked at"):
        drive({EGO: Oracle()}, poison=Poison)


def failing(monkeypatch):
    real = agents.egos.planning.solve

    def solve(*args, **kwargs):
        found = real(*args, **kwargs)
        wrong = tuple(np.full_like(u, np.nan) for u in found.controls)
        return found._replace(status=np.asarray(int(Status.ITERATION_LIMIT)), controls=wrong)

    monkeypatch.setattr(agents.egos.planning, "solve", solve)
    monkeypatch.setattr(agents.egos.hypotheses, "solve", solve)


@pytest.mark.parametrize("name", EGOS)
def test_a_failed_solve_continues_the_last_plan(name, monkeypatch):
    env = crossing(noise_std=0.0)
    policy = ego(name)
    observations, infos = env.reset(seed=1)
    memory = policy.init(env.scene, EGO)
    for _ in range(3):
        memory = policy.update(memory, observations[EGO], alone(infos[EGO]))
        decision, memory = policy.act(memory)
        assert not decision.plan_fallback
        observations, _, _, _, infos = env.step({EGO: decision.action})
    player = memory.plan.player
    longer = getattr(getattr(memory, "hypotheses", None), "solution", None)
    solution, player = (memory.plan.solution, player) if longer is None else (longer, 0)
    own = solution.controls[player]
    stages = len(own)
    failing(monkeypatch)
    for k in (1, 2):
        memory = policy.update(memory, observations[EGO], alone(infos[EGO]))
        decision, memory = policy.act(memory)
        assert decision.plan_fallback
        np.testing.assert_array_equal(decision.action, np.float32(own[k]))
        np.testing.assert_array_equal(
            decision.planned[: stages - k], solution.states[player][1 + k :, :2]
        )
        observations, _, _, _, infos = env.step({EGO: decision.action})


@pytest.mark.parametrize("policy", [Oracle(), constant_velocity()], ids=lambda p: p.name)
@pytest.mark.parametrize("velocity", [[0.0, 0.0], [0.5, -0.25]])
def test_without_a_plan_a_failed_solve_brakes(policy, velocity, monkeypatch):
    failing(monkeypatch)
    env = crossing(noise_std=0.0)
    start = np.array([[2.0, 2.0, *velocity], [0.0, 2.0, 0.0, 0.0]])
    observations, infos = env.reset(seed=1, options={"initial_state": start})
    memory = policy.init(env.scene, EGO)
    memory = policy.update(memory, observations[EGO], alone(infos[EGO]))
    if policy.name != "oracle":  # velocity takes two observations
        before = observations[EGO].copy()
        before[:2] -= DT * np.array(velocity)
        memory = policy.init(env.scene, EGO)
        memory = policy.update(memory, before, infos[EGO])
        memory = policy.update(memory, observations[EGO], alone(infos[EGO]))
    decision, _ = policy.act(memory)
    assert decision.plan_fallback
    assert decision.planned is None
    np.testing.assert_allclose(decision.action, -np.array(velocity) / DT, atol=1e-4)
    assert np.abs(decision.action).max() <= CONTROL_LIMIT
    assert decision.action.dtype == np.float32


def test_states_are_moved_into_their_bounds():
    game = crosswalk_game(2, HORIZON)
    states = [np.array([30.0, -30.0, 0.9, -0.9]), np.array([0.0, 0.0, 0.1, 0.2])]
    moved = inside_bounds(game, states)
    assert moved[0].tolist() == [30.0, -30.0, SPEED_LIMIT, -SPEED_LIMIT]
    assert moved[1].tolist() == states[1].tolist()


def test_unknown_names():
    with pytest.raises(
        ValueError, match=r"ego: 'nosuch' is unknown; choose from oracle, infer-gamma"
    ):
        make_ego("nosuch")
    env = crossing()
    env.reset(seed=0)
    for name in EGOS:
        assert make_ego(name).name.replace(" ", "-") == name
        with pytest.raises(ValueError, match="'pedestrian_1' is not controlled"):
            ego(name).init(env.scene, "pedestrian_1")
