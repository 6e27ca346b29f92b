"""The published intersection from cold starts: cars that turn between people."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.report import Result, Row, Setting
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import Status, shift, solve, verify
from foresight_env.games import Game, inside_bounds
from foresight_env.scenarios.aachen import AACHEN
from foresight_env.scenarios.intersection import driving_state, intersection_game, player_theta

WANTED_SECONDS = 0.010
"""Median of a forward solve, on a machine whose yardstick is 2.5 ms."""
SPREAD = np.array([0.3, 0.3, 0.2, 0.05])
"""Standard deviations of initial states around the published ones; of goals, 1 m."""
KINDS = {
    "2 pedestrians, 2 cars": AACHEN.kinds,
    "4 bicycles (the reference's)": ("bicycle", "bicycle", "car", "car"),
}


def draw(
    random: np.random.Generator, kinds: tuple[str, ...]
) -> tuple[np.ndarray, list[dict[str, Any]], np.ndarray]:
    """States, parameters and discount factors of one game."""
    states = AACHEN.initial_states.copy()
    for i, kind in enumerate(kinds):
        if kind != AACHEN.kinds[i]:
            states[i] = driving_state(states[i])
    states += SPREAD * random.normal(size=states.shape)
    goals = AACHEN.goals + random.normal(size=AACHEN.goals.shape)
    theta = [player_theta(kind, goal) for kind, goal in zip(kinds, goals, strict=True)]
    return states, theta, random.uniform(0.5, 1.0, len(kinds))


def row(name: str, kinds: tuple[str, ...], games: int) -> Row:
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
        guess = shift(solution)
        following = inside_bounds(game, [np.asarray(s[1]) for s in solution.states])
        again = partial(solve, game, following, theta, gamma, guess=guess)
        warm.append(median_seconds(again, 3))
    median = float(np.median(cold))
    return {
        "game": name,
        "games": games,
        "solved": f"{len(found) / games:.1%}",
        "infeasible": statuses.count(Status.INFEASIBLE),
        "local equilibria": f"{np.mean(found):.1%}",
        "iterations, median, p95": f"{np.median(steps):.0f}, {np.percentile(steps, 95):.0f}",
        "cold, median": yardstick.told(median),
        "of the wanted speed": WANTED_SECONDS * yardstick.seconds / 2.5e-3 / median,
        "warm, median": yardstick.told(float(np.median(warm))),
        "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
    }


def run(setting: Setting) -> list[Result]:
    """The study; `quick` has 10 games of each kind, else 100."""
    games = 10 if setting.quick else 100
    rows = [row(name, kinds, games) for name, kinds in KINDS.items()]
    note = (
        "28 stages of 0.24 s, all corners, road sides and limits as hard constraints, gamma "
        "uniform in (0.5, 1), initial states and goals drawn around the published ones, "
        f"{games} games each, cold. Warm: one stage later, from the shifted solution. Local "
        "equilibria: of those solved, by `verify`. Wanted: "
        f"{1e3 * WANTED_SECONDS:g} ms at a yardstick of 2.5 ms."
    )
    return [Result("The published intersection", note, rows).show(setting.console)]
