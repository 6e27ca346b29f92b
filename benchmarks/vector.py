"""Many crosswalks at once, compared with the same ones one by one."""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv

import foresight_env.envs  # noqa: F401  (registers the environments)
from benchmarks.report import Arguments, Result, TableRow
from foresight_env.envs.crosswalk.vector import CrosswalkVectorEnv

ID = "foresight/Crosswalk-v0"
PLAYERS = 2
MANY = 1024
FEW = 8
EPISODE = 10
"""Steps after a reset in which hardly anybody's episode ends."""


def _actions(seen: np.ndarray) -> np.ndarray:
    """To the goal; evades no agent."""
    wanted = 4.0 * (seen[:, -2:] - seen[:, :2]) - 3.0 * seen[:, 2:4]
    return np.clip(wanted, -10.0, 10.0).astype(np.float32)


def _rate(env: Any, steps: int, *, seed: int | None = None, skip: int = 0) -> float:
    """Environment steps per second over so many steps, after `skip` that do not count."""
    seen, _ = env.reset(seed=seed)
    for _ in range(skip):
        seen = env.step(_actions(seen))[0]
    begin = time.perf_counter()
    for _ in range(steps):
        seen = env.step(_actions(seen))[0]
    return float(env.num_envs * steps / (time.perf_counter() - begin))


def run(arguments: Arguments) -> list[Result]:
    """`quick` has a tenth of the environments and one repeat."""
    count, repeats = (MANY // 8, 1) if arguments.quick else (MANY, 3)
    rows: list[TableRow] = []
    for behaviour in ("open_loop", "receding"):

        def single(behaviour: str = behaviour) -> Any:
            return gymnasium.make(ID, disable_env_checker=True, behaviour=behaviour)

        many = CrosswalkVectorEnv(count, behaviour=behaviour)
        few = SyncVectorEnv([single] * FEW)
        for env in (many, few):  # compile: every size of batch that the measured steps need
            _rate(env, 70, seed=0)
        inside = np.median([_rate(many, EPISODE, seed=k, skip=1) for k in range(repeats)])
        whole = np.median([_rate(many, 70, seed=k) for k in range(repeats)])
        beside = np.median([_rate(few, 70, seed=k) for k in range(repeats)])
        rows.append(
            {
                "the others": behaviour.replace("_", " "),
                "environments": count,
                "agent-steps/s within episodes": f"{PLAYERS * inside:,.0f}",
                "agent-steps/s, resets included": f"{PLAYERS * whole:,.0f}",
                "env-steps/s, resets included": f"{whole:,.0f}",
                f"one by one ({FEW}), env-steps/s": f"{beside:,.0f}",
                "ratio": f"{whole / beside:.1f}",
            }
        )
    note = (
        f"Crosswalk, {PLAYERS} agents, full observations, `CrosswalkVectorEnv` and Gymnasium's "
        "`SyncVectorEnv` with the same arguments; the ego walks to its goal and evades no agent. "
        "Within episodes: the steps after the first, in which open-loop oracles have nothing to "
        f"solve. Resets included: 70 steps. Medians of {repeats}, without compilation, all cores."
    )
    return [Result("Many crosswalks at once", note, rows).show(arguments.console)]
