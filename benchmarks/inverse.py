"""Inverse solves: seconds, forward solves, and the paper's Algorithm 1 on the same sequences."""

from __future__ import annotations

import time
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import CompileTime, Yardstick, compile_seconds, median_seconds
from evaluation.studies.estimation import FREE, fit, observation_model, observe, truth
from foresight_env.equilibrium import Status
from foresight_env.inverse import (
    Estimate,
    GradientDescent,
    MultiStart,
    Prior,
    estimate,
    guess_initial_state,
)
from foresight_env.scenarios.crosswalk import crosswalk_game, player_theta

STD = 0.03
"""Noise of the sequences, m and m/s."""
SEQUENCES = 5
STARTS = 4
RATES = (1e-3, 1e-4, 1e-5, 1e-6)
"""Learning rates among which the best one is taken."""
LONGER = GradientDescent(1.0, max_iterations=20_000, tolerance=1e-9)
"""Algorithm 1 as far as it goes."""


def algorithm_1(
    observation: str, sequence: int, rate: float, method: GradientDescent = GradientDescent(1.0)
) -> Estimate:
    """The paper's Algorithm 1, one start, on the objective that `estimate` minimises too.

    A rate of `a` is a rate of 1 on an objective `a` times as large: so scaled, all rates share one
    compiled program. The returned cost is scaled back.
    """
    game, model = crosswalk_game(2), observation_model(observation)
    seen, gamma = observe(observation, STD, sequence, "soft")
    half = model.size // 2
    found = estimate(
        game,
        seen,
        model,
        initial_state=guess_initial_state(game, model, seen),
        theta=[player_theta(seen[-1, i * half : i * half + 2]) for i in range(2)],
        gamma=gamma,
        free=FREE["infer-gamma"],
        covariance=STD**2 / rate,
        prior=Prior(gamma_weight=1e-3 * rate),
        method=method,
        starts=MultiStart(1),
    )
    return found._replace(cost=np.asarray(found.cost / rate))


class Descent(NamedTuple):
    """Algorithm 1 at its best learning rate."""

    rate: float
    costs: list[float]
    seconds: list[float]
    solves: list[int]


def descend(
    observation: str, sequences: int, rate: float, method: GradientDescent = GradientDescent(1.0)
) -> Descent:
    """Algorithm 1 on the first `sequences` sequences; failures count as infinite."""
    costs, seconds, solves = [], [], []
    for k in range(sequences):
        begin = time.perf_counter()
        found = algorithm_1(observation, k, rate, method)
        seconds.append(time.perf_counter() - begin)
        solved = int(found.status) == Status.SOLVED
        costs.append(float(found.cost) if solved else np.inf)
        solves.append(int(found.num_forward_solves))
    return Descent(rate, costs, seconds, solves)


def best_descent(observation: str) -> Descent:
    """All sequences at the rate with the least mean objective on the first two."""
    algorithm_1(observation, 0, RATES[-1])  # compiles
    tried = [descend(observation, 2, rate) for rate in RATES]
    best = min(tried, key=lambda d: float(np.mean(d.costs)))
    return descend(observation, SEQUENCES, best.rate)


def rows_of(observation: str, compiled: CompileTime | None) -> list[TableRow]:
    """This estimator's line and Algorithm 1's, ratios to the former."""
    truth("soft")
    fit(observation, STD, 0, "infer-gamma", starts=STARTS)  # compiles
    yardstick = Yardstick.measure()
    found = [fit(observation, STD, k, "infer-gamma", starts=STARTS) for k in range(SEQUENCES)]
    seconds = [
        median_seconds(partial(fit, observation, STD, k, "infer-gamma", starts=STARTS))
        for k in range(SEQUENCES)
    ]
    published = best_descent(observation)
    longer = descend(observation, SEQUENCES, published.rate, LONGER)
    rows: list[TableRow] = [
        {
            "observed": observation,
            "method": f"Gauss-Newton, {STARTS} starts",
            "seconds": yardstick.formatted(float(np.median(seconds))),
            "forward solves": f"{np.median([f.num_forward_solves for f in found]):.0f}",
            "time ratio": 1.0,
            "objective ratio": 1.0,
            "compile, from cache": "-" if compiled is None else compiled.formatted,
            "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
        }
    ]
    for name, descent in (("", published), (", run on", longer)):
        costs = np.array(descent.costs) / [float(f.cost) for f in found]
        rows.append(
            {
                "observed": observation,
                "method": f"Algorithm 1, 1 start, rate {descent.rate:.0e}{name}",
                "seconds": yardstick.formatted(float(np.median(descent.seconds))),
                "forward solves": f"{np.median(descent.solves):.0f}",
                "time ratio": float(np.median(np.array(descent.seconds) / seconds)),
                "objective ratio": float(np.median(costs)),
                "compile, from cache": "-",
                "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
            }
        )
    return rows


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` measures one compile time instead of two."""
    rows: list[TableRow] = []
    for observation in ("full", "positions"):
        measured = not arguments.quick or observation == "full"
        compiled = compile_seconds("estimate", observation) if measured else None
        rows += rows_of(observation, compiled)
    note = (
        f"Crosswalk, T = 25, 14 unknowns, {SEQUENCES} noisy sequences (std {STD} m), discount "
        "factors started at random; medians. Ratios are to Gauss-Newton on the same sequences; an "
        "objective ratio above 1 means that Algorithm 1 stopped short, within its 500 iterations; "
        f"run on: up to {LONGER.max_iterations} iterations, until no step moves. "
        f"Its rate is the best of {', '.join(f'{r:.0e}' for r in RATES)}."
    )
    return [Result("Inverse solves", note, rows).show(arguments.console)]
