"""Environment steps per second."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.report import Result, Row, Setting
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.envs.crosswalk_v0 import parallel_env

VARIANTS: dict[str, dict[str, Any]] = {
    "one controlled, others receding": {"behaviour": "receding"},
    "one controlled, others open_loop": {"behaviour": "open_loop"},
    "all controlled": {"controlled": "all"},
}
EPISODE = 40
"""Steps that an episode is run for at most."""


def walk(env: Any, seed: int) -> int:
    """Run one episode, controlled agents heading for their goals; returns its steps."""
    observations, _ = env.reset(seed=seed)
    steps = 0
    while env.agents and steps < EPISODE:
        actions = {}
        for agent in env.agents:
            seen = observations[agent]
            wanted = 4.0 * (seen[-2:] - seen[:2]) - 3.0 * seen[2:4]
            actions[agent] = np.clip(wanted, -10.0, 10.0).astype(np.float32)
        observations = env.step(actions)[0]
        steps += 1
    return steps


def run(setting: Setting) -> list[Result]:
    """The study; `quick` has 3 episodes per variant, else 20."""
    episodes = 3 if setting.quick else 20
    yardstick = Yardstick.measure()
    rows: list[Row] = []
    for name, arguments in VARIANTS.items():
        for players in (2, 4):
            env = parallel_env(players=players, **arguments)
            counts = [walk(env, seed) for seed in range(episodes)]  # compiles, and counts

            def once(env: Any = env) -> None:
                for seed in range(episodes):
                    walk(env, seed)

            seconds = median_seconds(once) / sum(counts)
            env.close()
            rows.append(
                {
                    "variant": name,
                    "players": str(players),
                    "steps/s": f"{1.0 / seconds:.0f}",
                    "time per step": yardstick.told(seconds),
                }
            )
    note = (
        f"{episodes} episodes of up to {EPISODE} steps, resets included, 25 stages planned; "
        f"medians of 3 runs, one process. {yardstick.note}"
    )
    return [Result("Environment", note, rows).show(setting.console)]
