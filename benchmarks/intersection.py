"""The published intersection, forward from cold starts and inverse: cars that turn among people."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import Status, shift, solve, verify
from foresight_env.games import Game, full_state, inside_bounds
from foresight_env.games.motion import driving_state
from foresight_env.inverse import Free, Prior, estimate
from foresight_env.scenarios.aachen import AACHEN
from foresight_env.scenarios.intersection import intersection_game, player_theta

WANTED_SECONDS = 0.010
"""Median of a forward solve, on a machine whose yardstick is 2.5 ms."""
SPREAD = np.array([0.3, 0.3, 0.2, 0.05])
"""Standard deviations of initial states around the published ones; of goals, 1 m."""
KINDS = {
    "2 pedestrians, 2 cars": AACHEN.kinds,
    "4 kinematic bicycles (the reference's)": ("car",) * 4,
}


def draw(
    random: np.random.Generator, kinds: tuple[str, ...]
) -> tuple[np.ndarray, list[dict[str, Any]], np.ndarray]:
    """States, parameters and discount factors of one game."""
    states = AACHEN.initial_state.copy()
    for i, kind in enumerate(kinds):
        if kind != AACHEN.kinds[i]:
            states[i] = driving_state(states[i])
    states += SPREAD * random.normal(size=states.shape)
    goals = AACHEN.goals + random.normal(size=AACHEN.goals.shape)
    theta = [player_theta(kind, goal) for kind, goal in zip(kinds, goals, strict=True)]
    return states, theta, random.uniform(0.5, 1.0, len(kinds))


def row(name: str, kinds: tuple[str, ...], games: int) -> TableRow:
    """One line of the table."""
    game: Game = intersection_game(kinds, AACHEN.lanes, AACHEN.region)
    random = np.random.default_rng(0)
    drawn = [draw(random, kinds) for _ in range(games)]
    solve(game, *drawn[0])  # compiles
    yardstick = Yardstick.measure()
    cold, warm, steps, found, statuses = [], [], [], [], []
    for states, theta, gamma in drawn:
        call = partial(solve, game, states, theta, gamma)
        solution = call()
        cold.append(median_seconds(call, 3))
        steps.append(int(solution.iterations))
        statuses.append(Status(int(solution.status)))
        if statuses[-1] != Status.SOLVED:
            continue
        found.append(bool(verify(game, solution, theta, gamma).is_local_equilibrium))
        initial_guess = shift(solution)
        following = inside_bounds(game, [np.asarray(s[1]) for s in solution.states])
        again = partial(solve, game, following, theta, gamma, initial_guess=initial_guess)
        warm.append(median_seconds(again, 3))
    median = float(np.median(cold))
    return {
        "game": name,
        "games": games,
        "solved": f"{len(found) / games:.1%}",
        "infeasible": statuses.count(Status.INFEASIBLE),
        "local equilibria": f"{np.mean(found):.1%}",
        "iterations, median, p95": f"{np.median(steps):.0f}, {np.percentile(steps, 95):.0f}",
        "cold, median": yardstick.formatted(median),
        "of the target speed": WANTED_SECONDS * yardstick.seconds / 2.5e-3 / median,
        "warm, median": yardstick.formatted(float(np.median(warm))),
        "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
    }


PARAMETERS = ("goal_weight", "control_weight", "collision_weight", "collision_distance")
"""Estimated besides goals: discount factors and, of cars on lanes, the lane's weight."""
NOISE = 0.1
"""Standard deviation of observations, m, m/s and rad."""
BELIEF = Prior(
    theta_deviation=(
        ("goal", 5.0),
        *((name, 1.0) for name in PARAMETERS),
        ("lane_weight", 5.0),
    )
)
WANTED_INVERSE_SECONDS = 0.5


def inverse_row(name: str, kinds: tuple[str, ...], games: int) -> TableRow:
    """All parameters from the reference's starts: goals where last observed, weights at theirs."""
    game = intersection_game(kinds, AACHEN.lanes, AACHEN.region)
    random = np.random.default_rng(1)
    model = full_state(game.state_sizes)
    seconds, unexplained, errors, solves = [], [], [], []
    yardstick = Yardstick.measure()
    while len(seconds) < games:
        states, theta, gamma = draw(random, kinds)
        truth = solve(game, states, theta, gamma)
        if Status(int(truth.status)) != Status.SOLVED:
            continue
        exact = np.concatenate(truth.states, axis=1)
        start = [{**own, "goal": s[-1, :2]} for own, s in zip(theta, truth.states, strict=True)]
        free = []
        for own in theta:
            names = tuple(own)
            weights = tuple((weight, (0.05, 100.0)) for weight in names if weight != "goal")
            free.append(Free(names, theta_range=weights))
        call = partial(
            estimate,
            game,
            exact + random.normal(0.0, NOISE, exact.shape),
            model,
            initial_state=list(states),
            theta=start,
            gamma=np.full(len(kinds), 0.8),
            free=free,
            covariance=NOISE**2,
            prior=BELIEF,
        )
        if not seconds:
            call()  # compiles
        begin = time.perf_counter()
        found = call()
        seconds.append(time.perf_counter() - begin)
        solves.append(int(found.num_forward_solves))
        unexplained.append(float(found.cost) / exact.size)
        errors.append(float(np.mean((np.concatenate(found.solution.states, axis=1) - exact) ** 2)))
    median = float(np.median(seconds))
    return {
        "game": name,
        "windows": games,
        "parameters": len(found.parameters),
        "median": yardstick.formatted(median),
        "of the target speed": WANTED_INVERSE_SECONDS * yardstick.seconds / 2.5e-3 / median,
        "forward solves, median": f"{np.median(solves):.0f}",
        "objective per observed number, median": float(np.median(unexplained)),
        "root mean square error, median": float(np.sqrt(np.median(errors))),
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has 10 games of each kind, else 100."""
    games = 10 if arguments.quick else 100
    rows = [row(name, kinds, games) for name, kinds in KINDS.items()]
    note = (
        "28 stages of 0.24 s, all corners, road sides and limits as hard constraints, gamma "
        "uniform in (0.5, 1), initial states and goals drawn around the published ones, "
        f"{games} games each, cold. Warm: one stage later, from the shifted solution. Local "
        "equilibria: of those solved, by `verify`. Target: "
        f"{1e3 * WANTED_SECONDS:g} ms at a yardstick of 2.5 ms."
    )
    forward = Result("The published intersection", note, rows).show(arguments.console)
    windows = 1 if arguments.quick else 5
    inverse = [inverse_row(name, kinds, windows) for name, kinds in KINDS.items()]
    about = (
        f"Windows of 29 stages of such games, observed in full with noise {NOISE} (m, m/s, rad); "
        "goals start at last observed positions, weights where the truth is, discount factors at "
        "0.8, 8 starts. An objective of 1 per observed number is what the noise alone would leave. "
        f"Target: {1e3 * WANTED_INVERSE_SECONDS:g} ms at a yardstick of 2.5 ms."
    )
    title = "The published intersection, inverse"
    return [forward, Result(title, about, inverse).show(arguments.console)]
