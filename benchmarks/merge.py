"""The car merge of RD3G: two rows of cars on slip bicycles that merge into one lane.

T = 20, dt = 0.2 s, forward Euler, both axles 1 m from the middle, no bounds, gamma = 1, hard shared
distance of 2 m between all pairs.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import SolverOptions, Status, solve, solve_many, verify
from foresight_env.games import (
    Effort,
    Game,
    PermutationInvariant,
    Player,
    SharedInequality,
    SharedMinimumDistance,
    SlipBicycle,
    TargetSpeed,
)
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta

HORIZON = 20
LANE = 1.0
"""Lateral position of the lane that all cars merge into, m."""
SPEED = 2.0
"""Preferred, m/s."""
LEAST_DISTANCE = 2.0
"""Between the middles of two cars, m."""
ROUGH = 5e-4
"""Tolerance of RD3G's own figures."""
RIVALS = {2: (1.5, 0.91, 0.61), 4: (4.5, 0.80, 0.42), 8: (17.0, 0.66, 0.13)}
"""RD3G-SOSC at tolerance `ROUGH`: milliseconds, converged, of second order, by number of cars."""
BATCH = 1024


@dataclass(frozen=True)
class LaneTracking(PermutationInvariant):
    """`0.1 (y - lane)^2 + psi^2` of a car `[px, py, v, psi]`."""

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return 0.1 * (x[i][1] - LANE) ** 2 + x[i][3] ** 2


def merge_game(cars: int) -> Game:
    """The merge of so many cars."""
    costs = (LaneTracking(), TargetSpeed(SPEED, 0.01), Effort(0.3))
    car = Player(SlipBicycle(0.2, 1, 2.0), costs)
    pairs = cars * (cars - 1) // 2
    shared = SharedInequality(SharedMinimumDistance(LEAST_DISTANCE**2), pairs)
    return Game((car,) * cars, HORIZON, shared=(shared,))


def draw(cars: int, seed: int) -> Float[np.ndarray, "cars 4"]:
    """The initial states of one game, in RD3G's order of draws (NumPy's legacy generator)."""
    random = np.random.RandomState(seed)
    main = min(cars // 2, cars - 1)
    rest = cars - main
    x_main = np.linspace(0.0, 5.4 * (main - 1), main) + random.uniform(0.0, 1.0, main)
    offset = random.uniform(-2.5, 2.5)
    x_rest = (
        2.7 + offset + np.linspace(0.0, 5.4 * (rest - 1), rest) + random.uniform(0.0, 1.0, rest)
    )
    v_main = 2.0 + random.uniform(0.0, 1.0, main)
    v_rest = 2.0 + random.uniform(0.0, 1.0, rest)
    y = np.concatenate([np.full(main, 1.1), np.full(rest, -1.1)])
    x, v = np.concatenate([x_main, x_rest]), np.concatenate([v_main, v_rest])
    return np.stack([x, y, v, np.zeros(cars)], axis=1)


def row(cars: int, games: int, yardstick: Yardstick) -> TableRow:
    """One line of the table."""
    game = merge_game(cars)
    theta: list[dict[str, Any]] = [{} for _ in range(cars)]
    begin = time.perf_counter()
    solve(game, draw(cars, 0), theta, 1.0)
    first = time.perf_counter() - begin
    rough = SolverOptions(tolerance=ROUGH, barrier=ROUGH)
    solve(game, draw(cars, 0), theta, 1.0, options=rough)
    seconds, rough_seconds, steps, solved, verified = [], [], [], [], []
    for seed in range(games):
        states = draw(cars, seed)
        call = partial(solve, game, states, theta, 1.0)
        found = call()
        seconds.append(median_seconds(call))
        rough_seconds.append(median_seconds(partial(call, options=rough)))
        steps.append(int(found.iterations))
        solved.append(int(found.status) == Status.SOLVED)
        verified.append(solved[-1] and bool(verify(game, found, theta, 1.0).is_local_equilibrium))
    batch = np.stack([draw(cars, seed) for seed in range(BATCH)])
    many = partial(solve_many, game, batch, [theta] * BATCH, np.ones((BATCH, cars)))
    several = many()
    batch_seconds = median_seconds(many, 1)
    rival = RIVALS.get(cars)
    return {
        "cars": cars,
        "games": games,
        "solved": f"{np.mean(solved):.0%}",
        "verified": f"{np.mean(verified):.0%}",
        "Newton steps": int(np.median(steps)),
        "median": yardstick.formatted(float(np.median(seconds))),
        "p95": yardstick.formatted(float(np.percentile(seconds, 95))),
        f"to {ROUGH:g}, median": yardstick.formatted(float(np.median(rough_seconds))),
        "first call": f"{first:.1f} s",
        f"{BATCH} at once": f"{batch_seconds:.2f} s",
        "solved of these": f"{np.mean(several.status == Status.SOLVED):.1%}",
        "RD3G-SOSC": "-" if rival is None else "{} ms, {:.0%}, {:.0%}".format(*rival),
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` takes fewer games and cars."""
    sizes = (2, 4) if arguments.quick else (2, 3, 4, 5, 6, 8)
    yardstick = Yardstick.measure()
    rows = [row(cars, 20 if arguments.quick else 100, yardstick) for cars in sizes]
    note = (
        "RD3G's car merge, cold, tolerance 1e-8 unless stated, one solve at a time. RD3G-SOSC: "
        "time and shares converged and of second order by its authors, tolerance "
        f"{ROUGH:g}, at most 20 steps, hardware not stated. {yardstick.note}"
    )
    return [Result("Car merge", note, rows).show(arguments.console)]
