"""Environment steps per second."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0

VARIANTS: dict[str, dict[str, Any]] = {
    "one controlled, others receding": {"behaviour": "receding"},
    "one controlled, others open_loop": {"behaviour": "open_loop"},
    "one controlled, others idm": {"behaviour": "idm"},
    "all controlled": {"controlled": "all"},
}
WORLDS: dict[str, Any] = {
    "crosswalk, 2": partial(crosswalk_v0.parallel_env, players=2),
    "crosswalk, 4": partial(crosswalk_v0.parallel_env, players=4),
    "intersection, 2 + 2": intersection_v0.parallel_env,
    "driving, 2": partial(driving_v0.parallel_env, cars=2),
    "driving, 4": driving_v0.parallel_env,
}
"""Players, pedestrians + cars, and cars."""
CRUISE = 5.0
"""Speed that controlled cars keep, straight on, m/s."""
EPISODE = 40
"""Steps that an episode is run for at most."""


def walk(env: Any, seed: int) -> int:
    """Run one episode, controlled people heading for their goals; returns its steps."""
    observations, _ = env.reset(seed=seed)
    steps = 0
    while env.agents and steps < EPISODE:
        actions = {}
        for agent in env.agents:
            seen, space = observations[agent], env.action_space(agent)
            if agent.startswith("car"):
                wanted = np.array([CRUISE - seen[2], 0.0])
            else:
                wanted = 4.0 * (seen[-2:] - seen[:2]) - 3.0 * seen[2:4]
            actions[agent] = np.clip(wanted, space.low, space.high).astype(np.float32)
        observations = env.step(actions)[0]
        steps += 1
    return steps


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has 3 episodes per variant, else 20."""
    episodes = 3 if arguments.quick else 20
    yardstick = Yardstick.measure()
    rows: list[TableRow] = []
    for name, arguments in VARIANTS.items():
        for world, make in WORLDS.items():
            if "idm" in name and not world.startswith("driving"):
                continue
            env = make(**arguments)
            counts = [walk(env, seed) for seed in range(episodes)]  # compiles, and counts

            def once(env: Any = env) -> None:
                for seed in range(episodes):
                    walk(env, seed)

            seconds = median_seconds(once) / sum(counts)
            env.close()
            rows.append(
                {
                    "variant": name,
                    "world": world,
                    "steps/s": f"{1.0 / seconds:.0f}",
                    "time per step": yardstick.formatted(seconds),
                }
            )
    note = (
        f"{episodes} episodes of up to {EPISODE} steps, resets included; planned are 25, 15 and 11 "
        f"stages; medians of 3 runs, one process. {yardstick.note}"
    )
    return [Result("Environment", note, rows).show(arguments.console)]
