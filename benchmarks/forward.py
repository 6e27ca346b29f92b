"""Forward solves: how long, how many iterations, how often solved, how often an equilibrium."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import CompileTime, Yardstick, compile_seconds, median_seconds
from foresight_env.equilibrium import Solution, Status, shift, solve, verify
from foresight_env.games import Game, inside_bounds
from foresight_env.scenarios.crosswalk import MONTE_CARLO, Proximity, crosswalk_game

PROXIMITIES: tuple[Proximity, ...] = ("soft", "hard", "reference")
LEAST_GAMMA = 0.05
LEAST_GAMMA_REFERENCE = 0.7
"""The reference's proximity is not discounted: in current value its weight at stage t is
`gamma**-t`, which for small discount factors no solver can scale."""
TOLERANCE = 1e-6


class DrawnStart(NamedTuple):
    """One random game."""

    states: np.ndarray
    gamma: np.ndarray


def draw(count: int, least_gamma: float) -> list[DrawnStart]:
    """Random games around the Monte Carlo setting; the same ones every time."""
    random = np.random.default_rng(0)
    games = []
    for _ in range(count):
        states = MONTE_CARLO.initial_state.copy()
        states[:, :2] += random.uniform(-0.1, 0.1, (2, 2))
        games.append(DrawnStart(states, random.uniform(least_gamma, 1.0, 2)))
    return games


class Measured(NamedTuple):
    """Result of one game."""

    solved: bool
    equilibrium: bool
    iterations: int
    warm_iterations: int
    cold_seconds: float
    warm_seconds: float
    warm_solved: bool


def is_solved(solution: Solution) -> bool:
    """By status and by residual."""
    return int(solution.status) == Status.SOLVED and float(solution.residual) <= TOLERANCE


def measure(game: Game, drawn: DrawnStart, theta: Any, repeats: int) -> Measured:
    """Cold; then one stage later from the shifted solution, as an environment's step does."""
    states, gamma = drawn

    def cold() -> Solution:
        return solve(game, states, theta, gamma)

    found = cold()
    seconds = median_seconds(cold, repeats)
    if not is_solved(found):
        return Measured(False, False, int(found.iterations), 0, seconds, np.nan, False)
    initial_guess = shift(found)
    following = inside_bounds(game, [np.asarray(s[1]) for s in found.states])

    def warm() -> Solution:
        return solve(game, following, theta, gamma, initial_guess=initial_guess)

    again = warm()
    return Measured(
        True,
        bool(verify(game, found, theta, gamma).is_local_equilibrium),
        int(found.iterations),
        int(again.iterations),
        seconds,
        median_seconds(warm, repeats),
        is_solved(again),
    )


def row(
    proximity: Proximity, horizon: int, least_gamma: float, games: int, compiled: CompileTime | None
) -> TableRow:
    """One line of the table; `compiled` is measured elsewhere (None: not measured)."""
    game = crosswalk_game(2, horizon, proximity)
    drawn = draw(games, least_gamma)
    measure(game, DrawnStart(MONTE_CARLO.initial_state, MONTE_CARLO.gamma), MONTE_CARLO.theta, 1)
    yardstick = Yardstick.measure()
    each = [measure(game, d, MONTE_CARLO.theta, 3) for d in drawn]
    good = [m for m in each if m.solved]
    cold = np.array([m.cold_seconds for m in each])
    warm = np.array([m.warm_seconds for m in good])
    # What a call costs whatever the game, and what each Newton step adds to it.
    step, call = np.polyfit([m.iterations for m in each], cold, 1)
    return {
        "proximity": proximity,
        "T": str(horizon),
        "gamma": f"{least_gamma:g} to 1",
        "cold, median": yardstick.formatted(float(np.median(cold))),
        "cold, p95": yardstick.formatted(float(np.percentile(cold, 95))),
        "warm, median": yardstick.formatted(float(np.median(warm))),
        "warm, p95": yardstick.formatted(float(np.percentile(warm, 95))),
        "iterations cold, warm": f"{np.median([m.iterations for m in each]):.0f}, "
        f"{np.median([m.warm_iterations for m in good]):.0f}",
        "cold, per call + per step": f"{1e3 * call:.2f} + {1e3 * step:.3f} ms",
        "solved cold": f"{len(good) / games:.1%}",
        "solved warm": f"{np.mean([m.warm_solved for m in good]):.1%}",
        "local equilibria": f"{np.mean([m.equilibrium for m in good]):.1%}",
        "compile, from cache": "-" if compiled is None else compiled.formatted,
        "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` keeps to the full horizon and fewer games."""
    horizons = (25,) if arguments.quick else (10, 25)
    games = 30 if arguments.quick else 200
    rows = []
    for proximity in PROXIMITIES:
        for horizon in horizons:
            measured = not arguments.quick or proximity == "soft"
            compiled = compile_seconds("solve", proximity, str(horizon)) if measured else None
            rows.append(row(proximity, horizon, LEAST_GAMMA, games, compiled))
            if proximity == "reference":
                rows.append(row(proximity, horizon, LEAST_GAMMA_REFERENCE, games, compiled))
    note = (
        f"Crosswalk, 2 players, {games} random games (starts +-0.1 m, gamma uniform). Warm: one "
        "stage later, from the shifted solution. Solved: residual at most 1e-6 (warm: of those "
        "solved cold). Local equilibria: of those solved, by `verify`. Each time is the median of "
        "3 calls; times in brackets are multiples of the yardstick. Per call and per step: the "
        "line through all cold times over their Newton steps."
    )
    return [Result("Forward solves", note, rows).show(arguments.console)]
