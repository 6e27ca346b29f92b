"""Requirements of every environment of this library, as functions over a factory of environments.

The factory makes a fresh PettingZoo parallel environment. `as_parallel` presents a Gymnasium
environment as one, so that both kinds pass the same checks.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from foresight_env.games.paths import path_offset
from foresight_env.games.roads import RoadBoundary
from foresight_env.scenarios.junction import JUNCTION_REGION, LANES

Factory = Callable[[], Any]


class as_parallel:  # noqa: N801 (reads as a function)
    """A Gymnasium environment with PettingZoo's parallel interface."""

    def __init__(self, env: Any) -> None:
        self.env = env
        scene = env.unwrapped.scene
        self.possible_agents = [scene.names[scene.controlled[0]]]
        self.agents: list[str] = []

    @property
    def scene(self) -> Any:
        return self.env.unwrapped.scene

    def observation_space(self, agent: str) -> Any:
        assert [agent] == self.possible_agents
        return self.env.observation_space

    def action_space(self, agent: str) -> Any:
        assert [agent] == self.possible_agents
        return self.env.action_space

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observation, info = self.env.reset(seed=seed, options=options)
        self.agents = self.possible_agents[:]
        (ego,) = self.possible_agents
        return {ego: observation}, {ego: info}

    def step(self, actions: Any) -> Any:
        (ego,) = self.possible_agents
        if isinstance(actions, dict) and set(actions) == {ego}:
            actions = actions[ego]
        else:
            raise ValueError("actions: not for the ego")  # a Gymnasium user cannot do this
        result = self.env.step(actions)
        if result[2] or result[3]:
            self.agents = []
        return tuple({ego: part} for part in result)

    def close(self) -> None:
        self.env.close()


def towards_goal(
    observation: np.ndarray, full: bool, space: Any, random: np.random.Generator
) -> np.ndarray:
    """A policy that moves, saturates the speed limit and is a little random.

    What a car makes of it is not sensible, but it drives, also off the road.
    """
    velocity = observation[2:4] if full else 0.0
    wanted = 4.0 * (observation[-2:] - observation[:2]) - 3.0 * velocity
    return np.clip(wanted + random.normal(0.0, 2.0, 2), space.low, space.high).astype(np.float32)


def act(env: Any, observations: dict[str, np.ndarray], random: np.random.Generator) -> Any:
    """Actions of all live agents."""
    full = env.scene.observation == "full"
    return {a: towards_goal(observations[a], full, env.action_space(a), random) for a in env.agents}


def episode(env: Any, seed: int | None, options: dict[str, Any] | None = None) -> list[Any]:
    """A whole episode: what `reset` returned, then (actions, results) of every step."""
    random = np.random.default_rng(0)
    first = env.reset(seed=seed, options=options)
    rows: list[Any] = [deepcopy(first)]
    observations = first[0]
    while env.agents:
        actions = act(env, observations, random)
        results = env.step(actions)
        rows.append(deepcopy((actions, *results)))
        observations = results[0]
    return rows


def identical(a: Any, b: Any) -> bool:
    """Bitwise equality of nested results."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(identical(a[k], b[k]) for k in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(identical, a, b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return bool(a == b)


def arrays(tree: Any) -> list[np.ndarray]:
    """All arrays inside nested results."""
    if isinstance(tree, dict):
        return [v for part in tree.values() for v in arrays(part)]
    if isinstance(tree, (list, tuple)):
        return [v for part in tree for v in arrays(part)]
    return [tree] if isinstance(tree, np.ndarray) else []


def same_seed_same_episode(make: Factory) -> None:
    """Bitwise, over whole episodes, in one environment and across two; unseeded resets go on."""
    first, second = make(), make()
    rows = [episode(first, 7), episode(first, None), episode(first, 7), episode(first, None)]
    assert identical(rows[0], rows[2])
    assert identical(rows[1], rows[3])
    assert not identical(rows[0], rows[1])
    # Shorter first episodes must not change what the later ones are like.
    second.reset(seed=7)
    assert identical(rows[1], episode(second, None))


def seeds_differ(make: Factory) -> None:
    """Another seed is another hidden truth and another observation."""
    env = make()
    (seen, info), (other_seen, other_info) = env.reset(seed=1), env.reset(seed=2)
    for agent in env.possible_agents:
        assert not np.array_equal(seen[agent], other_seen[agent])
        assert not np.array_equal(info[agent]["gamma"], other_info[agent]["gamma"])
        assert not np.array_equal(info[agent]["state"], other_info[agent]["state"])


def observations_in_space(make: Factory) -> None:
    """At every step; spaces are stable objects, bounded, and start no warning when sampled."""
    env = make()
    spaces = {a: (env.observation_space(a), env.action_space(a)) for a in env.possible_agents}
    for row in episode(env, 3):
        observations = row[0] if len(row) == 2 else row[1]
        assert list(observations) == env.possible_agents
        for agent, observation in observations.items():
            space, action_space = spaces[agent]
            assert observation.dtype == np.float32
            assert space.contains(observation)
            assert np.isfinite(space.low).all()
            assert np.isfinite(space.high).all()
            assert env.observation_space(agent) is space
            assert env.action_space(agent) is action_space


def results_are_the_callers(make: Factory) -> None:
    """Later steps do not change what was returned, and spoiling it does not change the env."""
    env, spoilt = make(), make()
    kept: list[Any] = [env.reset(seed=4)]
    copies: list[Any] = [deepcopy(kept[0])]
    spoilt_seen = spoilt.reset(seed=4)
    seen, random = kept[0][0], np.random.default_rng(0)
    while env.agents:
        actions = act(env, seen, random)
        for array in arrays(list(spoilt_seen)):
            array.fill(1e6)
        for agent in spoilt.agents:
            own = spoilt.scene.own(agent)
            own.theta["goal"][:] = 1e6
            own.theta.clear()
        spoilt_seen = spoilt.step({a: v.copy() for a, v in actions.items()})
        kept.append(env.step(actions))
        copies.append(deepcopy(kept[-1]))
        assert identical(copies[-1], spoilt_seen)
        for array in actions.values():
            array.fill(0.0)
        seen = kept[-1][0]
    assert identical(kept, copies)
    buffers = [id(array) for array in arrays(kept)]
    assert len(set(buffers)) == len(buffers)


def options_are_copied(make: Factory) -> None:
    """Spoiling what was passed as options does not change the episode."""
    env = make()
    info = deepcopy(env.reset(seed=5)[1][env.possible_agents[0]])
    options = {
        "initial_state": info["state"],
        "gamma": info["gamma"],
        "goals": info["theta"]["goal"],
    }
    expected = episode(env, 5, deepcopy(options))
    random = np.random.default_rng(0)
    seen, _ = env.reset(seed=5, options=options)
    for array in options.values():
        array.fill(-3.0)
    assert identical(expected[1][1:], env.step(act(env, seen, random)))


WRONG = [
    pytest.param(lambda a: [a], id="not a dictionary"),
    pytest.param(lambda a: None, id="none"),
    pytest.param(lambda a: {k: a[k] for k in list(a)[1:]}, id="missing agent"),
    pytest.param(lambda a: {**a, "stranger": np.zeros(2)}, id="unknown agent"),
    pytest.param(lambda a: {k: np.zeros(3) for k in a}, id="wrong shape"),
    pytest.param(lambda a: {k: np.array([0.0, np.nan]) for k in a}, id="not a number"),
    pytest.param(lambda a: {k: np.array([0.0, 10.1]) for k in a}, id="outside the space"),
    pytest.param(lambda a: {k: "fast" for k in a}, id="text"),
    pytest.param(lambda a: {k: None for k in a}, id="no action"),
    pytest.param(lambda a: {k: [[1.0], [1.0, 2.0]] for k in a}, id="ragged"),
]


def wrong_actions_change_nothing(make: Factory, spoil: Callable[[Any], Any]) -> None:
    """They raise `ValueError`, and the episode continues as if they had not been given."""
    env, untouched = make(), make()
    random = np.random.default_rng(0)
    seen, _ = env.reset(seed=6)
    untouched.reset(seed=6)
    for _ in range(2):
        actions = act(env, seen, random)
        with pytest.raises(ValueError, match="action"):
            env.step(spoil(actions))
        results = env.step(actions)
        assert identical(results, untouched.step(actions))
        seen = results[0]


def instances_are_independent(make: Factory) -> None:
    """Two environments that take turns play as each does alone."""
    alone = [episode(make(), 11), episode(make(), 12)]
    envs = [make(), make()]
    randoms = [np.random.default_rng(0), np.random.default_rng(0)]
    rows: list[Any] = [[deepcopy(env.reset(seed=11 + k))] for k, env in enumerate(envs)]
    while any(env.agents for env in envs):
        for k, env in enumerate(envs):
            if env.agents:
                last = rows[k][-1]
                seen = last[0] if len(last) == 2 else last[1]
                actions = act(env, seen, randoms[k])
                rows[k].append(deepcopy((actions, *env.step(actions))))
    assert identical(alone, rows)


def crosswalk_cost(info: dict[str, Any], i: int) -> float:
    """The formula of the crosswalk's page, proximity `"soft"`."""
    theta, controls, places = info["theta"], info["controls"], info["state"][:, :2]
    to_goal = np.sum((places[i] - theta["goal"][i]) ** 2)
    gaps = np.sum((np.delete(places, i, 0) - places[i]) ** 2, axis=1)
    return (
        theta["goal_weight"][i] * to_goal
        + theta["control_weight"][i] * np.sum(controls[i] ** 2)
        + theta["collision_weight"][i] * np.sum(np.maximum(0.0, 1.2 - gaps))
    )


def intersection_cost(info: dict[str, Any], i: int) -> float:
    """The formula of the intersection's page."""
    theta, controls, places = info["theta"], info["controls"], info["state"][:, :2]
    walks = theta["lane_weight"] == 0.0
    others = [j for j in range(len(places)) if j != i and not (walks[i] and walks[j])]
    gaps = np.linalg.norm(places[others] - places[i], axis=1)
    cost = (
        theta["goal_weight"][i] * np.sum((places[i] - theta["goal"][i]) ** 2)
        + theta["control_weight"][i] * np.sum(controls[i] ** 2)
        + theta["collision_weight"][i]
        * np.sum(1.0 / (1.0 + np.exp(10.0 * (gaps - theta["collision_distance"][i]))))
    )
    for corner in JUNCTION_REGION.corners:
        radius = corner.radius * (0.3 if walks[i] else 1.0)
        cost += 100.0 * max(0.0, radius**2 - np.sum((places[i] - corner.center) ** 2))
    if walks[i]:
        return cost
    lane = LANES[i - np.sum(walks)]
    cost += theta["lane_weight"][i] * float(lane.offset(places[i])) ** 2
    beside = RoadBoundary(JUNCTION_REGION.sides)(0, 1, (jnp.asarray(places[i]),), (), {})
    return cost + 100.0 * float(np.sum(np.maximum(0.0, -np.asarray(beside))))


def driving_cost(info: dict[str, Any], i: int) -> float:
    """The formula of the page of driving."""
    theta, controls, states = info["theta"], info["controls"], info["state"]
    with jax.enable_x64(True):
        offset = float(path_offset(jnp.asarray(theta["path"][i]), jnp.asarray(states[i, :2])))
    ahead = 1.25 * np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])], axis=1)
    discs = np.stack([states[:, :2] + ahead, states[:, :2] - ahead], axis=1)
    others = np.delete(discs, i, 0).reshape(-1, 2)
    gaps = np.linalg.norm(discs[i][:, None] - others[None], axis=2)
    return (
        theta["path_weight"][i] * offset**2
        + theta["speed_weight"][i] * (states[i, 2] - theta["target_speed"][i]) ** 2
        + theta["control_weight"][i] * controls[i, 0] ** 2
        + theta["steering_weight"][i] * controls[i, 1] ** 2
        + theta["collision_weight"][i]
        * np.sum(np.maximum(0.0, theta["collision_distance"][i] - gaps) ** 2)
        + 50.0 * max(0.0, abs(offset) - 1.0)
    )


def reward_is_minus_stage_cost(make: Factory, cost: Callable[[Any, int], float]) -> None:
    """Recomputed from the information with the formula of the page."""
    env = make()
    for seed in (0, 1):
        for _, _, rewards, _, _, infos in episode(env, seed)[1:]:
            for agent, reward in rewards.items():
                i, info = int(agent[-1]), infos[agent]
                assert reward == pytest.approx(-cost(info, i), rel=1e-6)
                assert type(reward) is float
                assert np.array_equal(info["applied_action"], info["controls"][i])


def outcomes_partition(make: Factory, seeds: range = range(4)) -> None:
    """Ends are common, exclusive and explained; dictionaries hold exactly the live agents."""
    env = make()
    for seed in seeds:
        rows = episode(env, seed)
        for number, row in enumerate(rows[1:], start=1):
            _, observations, rewards, terminated, truncated, infos = row
            for part in (observations, rewards, terminated, truncated, infos):
                assert list(part) == env.possible_agents
            assert len(set(terminated.values())) == len(set(truncated.values())) == 1
            ended, timed_out = next(iter(terminated.values())), next(iter(truncated.values()))
            assert not (ended and timed_out)
            assert (ended or timed_out) == (number == len(rows) - 1)
            collision = any(info["collision"] for info in infos.values())
            reached = all(info["goal_reached"] for info in infos.values())
            off_road = any(info["off_road"] for info in infos.values())
            assert ended == (collision or off_road or reached)
            assert timed_out == (not ended and number == env.scene.max_steps)
            for info in infos.values():
                assert info["collision"] == (info["min_distance"] < 0.0)
                harmed = info["collision"] or info["off_road"]
                assert info["is_success"] == (info["goal_reached"] and not harmed)
                assert info["time"] == pytest.approx(number * env.scene.dt)
        assert env.agents == []


def order_is_enforced(make: Factory) -> None:
    """Steps before `reset` and after the end are refused."""
    env = make()
    zero = {a: np.zeros(2, dtype=np.float32) for a in env.possible_agents}
    with pytest.raises(ResetNeeded):
        env.step(zero)
    episode(env, 0)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(zero)


def observations_are_noisy_states(make: Factory) -> None:
    """Observation minus `h` of the true state has the stated spread; the goal comes exact."""
    env = make()
    scene = env.scene
    errors = []
    for seed in range(5):
        for row in episode(env, seed):
            seen, infos = (row[0], row[1]) if len(row) == 2 else (row[1], row[5])
            for agent, observation in seen.items():
                model = scene.observation_model(agent)
                truth = np.asarray(model(tuple(jnp.asarray(s) for s in infos[agent]["state"])))
                assert model.size == truth.size == observation.size - 2
                assert model.owners[0] == int(agent[-1])
                errors.append(observation[:-2] - truth)
                goal = infos[agent]["theta"]["goal"][int(agent[-1])]
                assert np.array_equal(observation[-2:], goal.astype(np.float32))
                assert env.scene.own(agent).gamma == infos[agent]["gamma"][int(agent[-1])]
    spread = np.std(np.concatenate(errors))
    assert spread == pytest.approx(scene.noise_std, rel=0.2)


CHECKS = (
    same_seed_same_episode,
    seeds_differ,
    observations_in_space,
    results_are_the_callers,
    options_are_copied,
    instances_are_independent,
    outcomes_partition,
    order_is_enforced,
    observations_are_noisy_states,
)
"""Every check that needs a factory only."""
