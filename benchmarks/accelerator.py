"""Many games at once on an accelerator and on the processor of the same machine.

`python -m benchmarks.accelerator HORIZON LANES GAMES FILE` measures one batch on JAX's default
device and leaves the solved states in FILE: a separate process, because a process keeps the
device that it began with.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from benchmarks.forward import LEAST_GAMMA, draw
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import ROOT, median_seconds, processor, seconds_of
from foresight_env.equilibrium import Status, solve_many
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

HORIZONS = (10, 25)
WIDTHS = (1024, 8192)
"""Games that step together on the accelerator; a batch is twice as many."""
PROCESSOR_GAMES = 1024


class Batch(NamedTuple):
    """One measured batch."""

    device: str
    games_per_second: float
    solved: float
    compile_seconds: float
    states: np.ndarray


def measure(horizon: int, batch_size: int, games: int, file: Path) -> None:
    """Median of three, printed as JSON; `file` receives the states."""
    game = crosswalk_game(2, horizon)
    drawn = draw(games, LEAST_GAMMA)
    states, gammas = np.stack([d.states for d in drawn]), np.stack([d.gamma for d in drawn])
    # A processor's cores share the games; an accelerator takes all of them at once.
    threads = None if jax.default_backend() == "cpu" else 1
    batch = partial(
        solve_many, game, states, MONTE_CARLO.theta, gammas, batch_size=batch_size, threads=threads
    )
    first = seconds_of(batch)
    seconds = median_seconds(batch, 3)
    found = batch()
    np.save(file, np.concatenate(found.states, axis=2))
    report = {
        "device": jax.devices()[0].device_kind,
        "games_per_second": games / seconds,
        "solved": float(np.mean(found.status == Status.SOLVED)),
        "compile_seconds": first - seconds,
    }
    print(json.dumps(report))


def measured(horizon: int, batch_size: int, games: int, platform: str | None) -> Batch:
    """`measure` in a process on that platform; None: JAX's choice."""
    environment = dict(os.environ)
    if platform is not None:
        environment["JAX_PLATFORMS"] = platform
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "states.npy"
        run = subprocess.run(
            [sys.executable, "-m", __spec__.name, *map(str, (horizon, batch_size, games, file))],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return Batch(**json.loads(run.stdout.splitlines()[-1]), states=np.load(file))


def row(horizon: int, batch_size: int, games: int, batch: Batch, beside: Batch) -> TableRow:
    """One line; `beside`: the processor's batch of the same games, as many as it had."""
    common = min(len(batch.states), len(beside.states))
    apart = np.abs(batch.states[:common] - beside.states[:common]).max(axis=(1, 2))
    return {
        "T": str(horizon),
        "device": batch.device,
        "games together": batch_size,
        "games": games,
        "solved": f"{batch.solved:.1%}",
        "games per second": f"{batch.games_per_second:.0f}",
        "of the processor's": batch.games_per_second / beside.games_per_second,
        "same solution": f"{np.mean(apart < 1e-6):.1%}",
        "compile": f"{batch.compile_seconds:.0f} s",
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; without an accelerator there is nothing to compare."""
    title = "Many games at once on an accelerator"
    if jax.default_backend() == "cpu":
        note = "JAX finds no accelerator here; nothing was measured."
        return [Result(title, note, []).show(arguments.console)]
    rows = []
    for horizon in HORIZONS[-1:] if arguments.quick else HORIZONS:
        beside = measured(horizon, 1, PROCESSOR_GAMES, "cpu")
        rows.append(row(horizon, 1, PROCESSOR_GAMES, beside, beside))
        for width in WIDTHS[:1] if arguments.quick else WIDTHS:
            batch = measured(horizon, width, 2 * width, None)
            rows.append(row(horizon, width, 2 * width, batch, beside))
    note = (
        "Crosswalk, 2 players, random games from a cold start, double precision, `solve_many`; "
        f"medians of 3, without compile time. Processor: {processor()}, "
        f"{len(os.sched_getaffinity(0))} cores. Same solution: states of the processor's games "
        "to 1e-6 m and m/s."
    )
    return [Result(title, note, rows).show(arguments.console)]


if __name__ == "__main__":
    measure(*map(int, sys.argv[1:4]), Path(sys.argv[4]))
