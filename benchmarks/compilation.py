"""`python -m benchmarks.compilation [KIND ...]`: how long first calls compile.

Kinds: `solve PROXIMITY HORIZON`, `estimate OBSERVATION`, `junction` (a fit of four agents). Prints
the seconds that a first call takes beyond a second one, as JSON. Without a kind: a table of all
three by stage (tracing, lowering, compiling), with and without XLA's fusion emitters, and the time
of a second call. Every measurement has its own process, so that nothing is compiled yet.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from benchmarks.timing import ROOT, SINGLE_THREAD, Yardstick, seconds_of
from foresight_env import compilation

SEQUENCE_STD = 0.03
"""Noise of the sequence that the estimate is made from, m and m/s."""
STAGES = {
    "trace": "jaxpr_trace_duration",
    "lower": "jaxpr_to_mlir_module_duration",
    "compile": "backend_compile_duration",
}
"""Stages of compilation, by the events that JAX sends at their ends."""
PROGRAMS = (("solve", "soft", "25"), ("estimate", "full"), ("junction",))
EMITTERS = "--fusion-emitters"


def solve_call(proximity: str, horizon: str) -> Callable[[], Any]:
    """The forward solver."""
    from foresight_env.equilibrium import solve
    from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

    game, setting = crosswalk_game(2, int(horizon), proximity), MONTE_CARLO
    return lambda: solve(game, setting.initial_state, setting.theta, setting.gamma)


def estimate_call(observation: str) -> Callable[[], Any]:
    """The estimator; the forward solve that makes the observations comes before."""
    from evaluation.studies import estimation

    estimation.truth("soft")
    return lambda: estimation.fit(observation, SEQUENCE_STD, 0, "infer-gamma")


def junction_call() -> Callable[[], Any]:
    """The fit of four agents at the intersection; one game from one start, to compile mostly."""
    from evaluation.samples.junction import TRACKS, write_junction_sample
    from evaluation.studies import intersection
    from evaluation.windows.intersection import Choice, load
    from foresight_env.inverse import GaussNewton, MultiStart, estimate

    folder = Path(tempfile.mkdtemp())
    write_junction_sample(folder / "sample")
    case = load(Choice(str(folder / "sample"), tuple(TRACKS)))

    def brief(*arguments: Any, **named: Any) -> Any:
        own = {"method": GaussNewton(max_iterations=0), "starts": MultiStart(1)}
        return estimate(*arguments, **{**named, **own})

    intersection.estimate = brief  # type: ignore[attr-defined]
    return lambda: intersection.fit(case, "full", 0.0, 0, "infer-gamma", "goals")


CALLS: dict[str, Callable[..., Callable[[], Any]]] = {
    "solve": solve_call,
    "estimate": estimate_call,
    "junction": junction_call,
}


def profile(kind: str, *arguments: str) -> dict[str, float]:
    """Seconds of each stage, CPU seconds of all, and seconds of a second call; in this process."""
    call, spent = CALLS[kind](*arguments), Counter[str]()

    def listen(event: str, duration_secs: float, **details: str | int) -> None:
        spent[event.split("/")[-1]] += duration_secs  # type: ignore[assignment]

    jax.monitoring.register_event_duration_secs_listener(listen)
    times = []
    for _ in range(2):
        begin, cpu = time.perf_counter(), time.process_time()
        call()
        times.append((time.perf_counter() - begin, time.process_time() - cpu))
    (first, first_cpu), (second, second_cpu) = times
    return {
        **{stage: float(spent[event]) for stage, event in STAGES.items()},
        "all, wall": first - second,
        "all, CPU": first_cpu - second_cpu,
        "second call": second,
    }


def table() -> None:
    """Print the profiles of all programs."""
    columns = [*STAGES, "all, wall", "all, CPU", "second call"]
    shown = Table("program", "fusion emitters", *columns)
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    for program in PROGRAMS:
        for options in ((), (EMITTERS,)):
            run = subprocess.run(
                [sys.executable, "-m", "benchmarks.compilation", "profile", *program, *options],
                cwd=ROOT,
                env={**environment, **SINGLE_THREAD},
                capture_output=True,
                text=True,
                check=True,
            )
            found = json.loads(run.stdout.splitlines()[-1])
            shown.add_row(
                " ".join(program),
                "yes" if options else "no",
                *(f"{found[name]:.2f}" for name in columns),
            )
    console = Console(width=120)
    console.print(shown)
    console.print(f"Seconds, without a cache. {Yardstick.measure().note}")


def main(arguments: list[str]) -> None:
    """Print the table, or the numbers of one program as JSON."""
    if not arguments:
        table()
        return
    if EMITTERS in arguments:  # before any module of the library compiles something
        compilation.COMPILER_OPTIONS.clear()
        arguments = [a for a in arguments if a != EMITTERS]
    kind, *rest = arguments
    if kind == "profile":
        print(json.dumps(profile(*rest)))
    else:
        call = CALLS[kind](*rest)
        print(json.dumps(seconds_of(call) - seconds_of(call)))


if __name__ == "__main__":
    main(sys.argv[1:])
