"""Rough use: extreme and malformed actions, options and configurations; broken sensors.

Whatever is wrong must be refused by a `ValueError`, whatever fails must be a status, nothing may be
NaN, and memory must stay flat. What breaks one of these is a *violation*; there should be none. The
full study takes an hour.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.robustness.environments import (
    PARALLEL,
    use_parallel,
    use_single,
    use_turns,
    use_vector,
)
from benchmarks.robustness.sensors import use_ego, use_estimator, use_predictor
from benchmarks.robustness.tally import Random, Tally
from foresight_env.envs.registration import SCENARIOS, VECTOR

MINUTES = 60.0
QUICK_MINUTES = 2.0
LEAST_EPISODES = 10_000
"""Whole episodes of environments that the full study plays at least, over all ids."""
MOST_GROWTH = 1.1
"""Of memory, over the second half of the time."""
MEBIBYTE = 2**20

Use = Callable[[Random, Tally], None]


def uses() -> dict[str, tuple[Use, float]]:
    """By kind: what is done, and its weight when one is drawn."""
    found: dict[str, tuple[Use, float]] = {
        name: (partial(use_parallel, name), 1.0) for name in PARALLEL
    }
    for scenario in SCENARIOS:
        found[f"{scenario}, Gymnasium"] = (partial(use_single, scenario), 1.0)
        found[f"{scenario}, in turn"] = (partial(use_turns, scenario), 1.0)
    for scenario in VECTOR:
        found[f"{scenario}, vector"] = (partial(use_vector, scenario), 1.0)
    return found | {
        "estimator": (use_estimator, 0.7),
        "predictors": (use_predictor, 1.0),
        "ego": (use_ego, 0.3),
    }


def rough_use(seconds: float, least: int, seed: int = 0) -> tuple[Tally, list[float]]:
    """Use everything once, then at random for `seconds` and until `least` episodes are over.

    Also returns the memory of this process (MiB) after each tenth of the time, the first of them
    when everything had been used once.
    """
    random, tally, every = np.random.default_rng(seed), Tally(), uses()
    weights = np.array([weight for _, weight in every.values()])

    def once(kind: str) -> None:
        try:
            every[kind][0](random, tally)
        except Exception as error:
            tally.violations.append(f"{kind}: {type(error).__name__}: {error}")

    for kind in every:
        once(kind)
    begin, memory = time.monotonic(), [resident_memory()]
    while (passed := time.monotonic() - begin) < seconds or tally.episodes.total() < least:
        once(str(random.choice(list(every), p=weights / weights.sum())))
        if passed > len(memory) * seconds / 10.0 > 0.0:
            memory.append(resident_memory())
    memory.append(resident_memory())
    if seconds > 0.0 and memory[-1] > MOST_GROWTH * memory[len(memory) // 2]:
        tally.violations.append(f"memory: grew over the second half, {memory} MiB")
    return tally, memory


def resident_memory() -> float:
    """Of this process, MiB; NaN where the system does not report it."""
    gc.collect()
    usage = Path("/proc/self/statm")
    if not usage.exists():
        return float("nan")
    return int(usage.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MEBIBYTE


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` takes two minutes."""
    minutes, least = (QUICK_MINUTES, 0) if arguments.quick else (MINUTES, LEAST_EPISODES)
    begin = time.monotonic()
    tally, memory = rough_use(60.0 * minutes, least)
    passed = (time.monotonic() - begin) / 60.0
    crashed = {v.partition(": ")[0] for v in tally.violations}
    rows: list[TableRow] = [
        {
            "used": name,
            "times": tally.done[name],
            "wrong calls refused": tally.refused[name],
            "failures with a status": tally.failed[name],
            "violations": sum(v.startswith(f"{name}: ") for v in tally.violations),
        }
        for name in sorted(set(tally.done) | set(tally.refused) | crashed)
    ]
    series = ", ".join(f"{value:.0f}" for value in memory)
    first = "; ".join(dict.fromkeys(tally.violations[:5])) or "none"
    note = (
        f"{tally.done.total()} uses in {passed:.0f} minutes, drawn at random, with "
        f"{tally.episodes.total()} whole episodes of environments; resident memory at each tenth "
        f"of the time (MiB): {series}. Violations: {len(tally.violations)} ({first})."
    )
    ids: list[TableRow] = [
        {"id": name, "episodes": n} for name, n in sorted(tally.episodes.items())
    ]
    return [
        Result("Rough use", note, rows).show(arguments.console),
        Result("Episodes of rough use", "Over all ids.", ids).show(arguments.console),
    ]
