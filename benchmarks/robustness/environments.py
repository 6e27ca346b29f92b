"""Episodes of every registered environment, with wrong calls in between."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from benchmarks.robustness.tally import Random, Tally
from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0
from foresight_env.equilibrium import Status

MODULES = {"crosswalk": crosswalk_v0, "intersection": intersection_v0, "driving": driving_v0}

PARALLEL: dict[str, tuple[str, dict[str, Any]]] = {
    "crosswalk, receding": (
        "crosswalk", {"planning_horizon": 6, "max_steps": 12, "noise_std": 0.1}
    ),
    "crosswalk, three open loop": (
        "crosswalk",
        {
            "players": 3, "behaviour": "open_loop", "observation": "positions", "max_steps": 12,
            "planning_horizon": 6,
        },
    ),
    "crosswalk, all controlled": ("crosswalk", {"players": 6, "controlled": "all"}),
    "intersection": (
        "intersection", {"pedestrians": 1, "cars": 1, "planning_horizon": 6, "max_steps": 8}
    ),
    "left turn": ("driving", {"cars": 2, "planning_horizon": 4, "max_steps": 8}),
    "merge, IDM": (
        "driving", {"scene": "merge", "cars": 3, "behaviour": "idm", "max_steps": 20}
    ),
    "lane change, IDM": (
        "driving", {"scene": "lane_change", "cars": 3, "behaviour": "idm", "max_steps": 20}
    ),
    "roundabout, all controlled": (
        "driving", {"scene": "roundabout", "cars": 4, "controlled": "all", "max_steps": 30}
    ),
}  # fmt: skip
"""Scenarios with arguments; few games are compiled, and what is below shares them."""

SMALL: dict[str, dict[str, Any]] = {
    scenario: PARALLEL[name][1]
    for scenario, name in (
        ("crosswalk", "crosswalk, receding"),
        ("intersection", "intersection"),
        ("driving", "left turn"),
    )
}
"""Arguments of the ids' other forms."""

WRONG_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "planning_horizon": (0, -1, 2.5, "long", None),
    "max_steps": (0, -3, np.nan, "many"),
    "noise_std": (-0.1, np.nan, np.inf, "much"),
    "observation": ("everything", None, 3),
    "behaviour": ("asleep", 7),
    "controlled": ((99,), (0, 0), "some", (-1,), (0.5,)),
    "render_mode": ("ascii", 1),
    "ranges": ((0.3, 1.0), "wide"),
}

ACTIONS: dict[str, Callable[[Random, Any], np.ndarray]] = {
    "highest": lambda random, space: space.high,
    "lowest": lambda random, space: space.low,
    "corner": lambda random, space: np.where(random.random(2) < 0.5, space.low, space.high),
    "nothing": lambda random, space: np.zeros_like(space.low),
    "anything": lambda random, space: random.uniform(space.low, space.high).astype(np.float32),
    "tiny": lambda random, space: np.full_like(space.low, np.finfo(np.float32).tiny),
    "in double precision": lambda random, space: random.uniform(space.low, space.high),
}

SPOILED: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no dictionary": lambda actions: list(actions.values()),
    "none": lambda actions: None,
    "no agents": lambda actions: {},
    "a stranger": lambda actions: {**actions, "stranger": np.zeros(2)},
    "not a number": lambda actions: {a: np.array([np.nan, 0.0]) for a in actions},
    "infinite": lambda actions: {a: np.array([np.inf, 0.0]) for a in actions},
    "out of range": lambda actions: {a: np.array([1e3, 0.0]) for a in actions},
    "wrong shape": lambda actions: {a: np.zeros((2, 2)) for a in actions},
    "ragged": lambda actions: {a: [[1.0], [1.0, 2.0]] for a in actions},
    "text": lambda actions: {a: "left" for a in actions},
    "complex": lambda actions: {a: np.array([1j, 0.0]) for a in actions},
}


def _options(random: Random, players: int, states: np.ndarray) -> dict[str, Any]:
    """Options of `reset`, legal and illegal ones."""
    shape = np.shape(states)
    cases: list[dict[str, Any]] = [
        {},
        {"gamma": random.uniform(0.0, 1.0, players)},
        {"gamma": np.zeros(players)},
        {"gamma": np.full(players, 1.2)},
        {"initial_state": states + random.normal(0.0, 0.1, shape)},
        {"initial_state": np.tile(states[:1], (players, 1))},  # all in one place
        {"initial_state": 1e6 * np.ones(shape)},
    ]
    return cases[random.integers(len(cases))]


WRONG_OPTIONS: tuple[Any, ...] = (
    {"gamma": [np.nan]},
    {"gamma": "patient"},
    {"gamma": -np.ones(2)},
    {"goals": [[np.inf, 0.0]]},
    {"initial_state": np.zeros(3)},
    {"unknown": 1},
    "options",
    {"episode_parameters": {"gamma": 1.0}},
)


def use_parallel(name: str, random: Random, tally: Tally) -> None:
    """One episode of a parallel environment, with wrong calls in between."""
    scenario, arguments = PARALLEL[name]
    make = partial(MODULES[scenario].parallel_env, **arguments)
    if random.random() < 0.1:
        argument = list(WRONG_ARGUMENTS)[random.integers(len(WRONG_ARGUMENTS))]
        values = WRONG_ARGUMENTS[argument]
        wrong = {argument: values[random.integers(len(values))]}
        tally.must_refuse(name, f"argument {wrong}", lambda: make(**wrong))
    env = make()
    seed = int(random.integers(2**31))
    if random.random() < 0.3:
        spoiled = WRONG_OPTIONS[random.integers(len(WRONG_OPTIONS))]
        told = f"options {spoiled!r}"
        tally.must_refuse(name, told, lambda: env.reset(seed=seed, options=spoiled))
    env.reset(seed=seed)
    scene = env.scene
    first = np.asarray(env.reset(seed=seed)[1][env.agents[0]]["state"])
    try:
        options = _options(random, scene.players, first)
        observations, infos = env.reset(seed=seed, options=options)
    except ValueError:
        tally.refused[name] += 1
        observations, infos = env.reset(seed=seed)
    _judge(name, env, observations, {}, infos, tally)
    kinds = list(ACTIONS.values())
    usual = kinds[random.integers(len(kinds))]
    while env.agents:
        chosen = usual if random.random() < 0.7 else kinds[random.integers(len(kinds))]
        actions = {a: chosen(random, env.action_space(a)) for a in env.agents}
        if random.random() < 0.15:
            told, spoil = list(SPOILED.items())[random.integers(len(SPOILED))]
            wrong_actions = spoil(actions)
            tally.must_refuse(name, f"actions, {told}", lambda: env.step(wrong_actions))  # noqa: B023
        observations, rewards, _, _, infos = env.step(actions)
        _judge(name, env, observations, rewards, infos, tally)
    env.close()
    tally.done[name] += 1
    tally.episodes[f"foresight/{scenario}-v0, parallel"] += 1


def _judge(name: str, env: Any, observations: Any, rewards: Any, infos: Any, tally: Tally) -> None:
    for agent, seen in observations.items():
        if not env.observation_space(agent).contains(seen):
            tally.violations.append(f"{name}: observation outside its space: {seen}")
    tally.must_be_finite(name, "rewards", *rewards.values())
    for info in infos.values():
        told = [info[key] for key in ("state", "gamma", "controls", "min_distance", "time")]
        tally.must_be_finite(name, "information", *told)
        status = int(info["solver_status"])
        if status not in (-1, *map(int, Status)):
            tally.violations.append(f"{name}: unknown status {status}")
        tally.failed[name] += status not in (-1, Status.SOLVED)


def use_turns(scenario: str, random: Random, tally: Tally) -> None:
    """One episode of the form whose agents act in turn (AEC)."""
    name = f"{scenario}, in turn"
    env = MODULES[scenario].env(**SMALL[scenario])
    env.reset(seed=int(random.integers(2**31)))
    kinds = list(ACTIONS.values())
    for agent in env.agent_iter():
        _, reward, terminated, truncated, _ = env.last()
        tally.must_be_finite(name, "reward", reward)
        kind = kinds[random.integers(len(kinds))]
        over = terminated or truncated
        env.step(None if over else kind(random, env.action_space(agent)))
    env.close()
    tally.done[name] += 1
    tally.episodes[f"foresight/{scenario}-v0, AEC"] += 1


def use_single(scenario: str, random: Random, tally: Tally) -> None:
    """One episode of a Gymnasium id with random actions."""
    name = f"{scenario}, Gymnasium"
    made = f"foresight/{scenario.capitalize()}-v0"
    env = gymnasium.make(made, **SMALL[scenario])
    seen, _ = env.reset(seed=int(random.integers(2**31)))
    kinds, done = list(ACTIONS.values()), False
    while not done:
        seen, reward, terminated, truncated, _ = env.step(
            np.asarray(kinds[random.integers(len(kinds))](random, env.action_space), np.float32)
        )
        tally.must_be_finite(name, "observation, reward", seen, reward)
        done = terminated or truncated
    env.close()
    tally.done[name] += 1
    tally.episodes[made] += 1


def use_vector(scenario: str, random: Random, tally: Tally) -> None:
    """One episode each of some environments that move together."""
    name, together = f"{scenario}, vector", 4
    made = f"foresight/{scenario.capitalize()}-v0"
    env = gymnasium.make_vec(
        made, num_envs=together, vectorization_mode="vector_entry_point", **SMALL[scenario]
    )
    seen, _ = env.reset(seed=int(random.integers(2**31)))
    kinds, over = list(ACTIONS.values()), np.zeros(together, bool)
    while not over.all():
        if random.random() < 0.1:
            spoiled = np.full(env.action_space.shape, random.choice([np.nan, np.inf, 1e3]))
            tally.must_refuse(name, f"actions {spoiled[0]}", lambda: env.step(spoiled))  # noqa: B023
        kind = kinds[random.integers(len(kinds))]
        actions = [kind(random, env.single_action_space) for _ in range(together)]
        seen, rewards, terminated, truncated, _ = env.step(np.asarray(actions, np.float32))
        tally.must_be_finite(name, "observations, rewards", seen, rewards)
        over |= terminated | truncated
    env.close()
    tally.done[name] += 1
    tally.episodes[f"{made}, vector"] += together
