"""Many games at once: games per second, compared with one after the other."""

from __future__ import annotations

import resource
from functools import partial

import numpy as np

from benchmarks.forward import LEAST_GAMMA, draw
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import Status, solve, solve_many
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

HORIZONS = (10, 25)
WANTED = {10: 5000.0, 25: 800.0}
"""Games per second on a machine whose yardstick is `REFERENCE_YARDSTICK`."""
REFERENCE_YARDSTICK = 2.5e-3


def row(horizon: int, games: int, threads: int) -> TableRow:
    """One line: `solve_many` on all games, `solve` on the first hundred of them."""
    game = crosswalk_game(2, horizon)
    drawn = draw(games, LEAST_GAMMA)
    states, gammas = np.stack([d.states for d in drawn]), np.stack([d.gamma for d in drawn])
    batch = partial(solve_many, game, states, MONTE_CARLO.theta, gammas, threads=threads)
    found = batch()  # compiles

    def singly() -> None:
        for d in drawn[:100]:
            solve(game, d.states, MONTE_CARLO.theta, d.gamma)

    singly()
    yardstick = Yardstick.measure()
    seconds = median_seconds(batch, 5) / games
    alone = median_seconds(singly, 3) / min(games, 100)
    wanted = WANTED[horizon] * REFERENCE_YARDSTICK / yardstick.seconds
    return {
        "T": str(horizon),
        "threads": str(threads),
        "games": str(games),
        "solved": f"{np.mean(found.status == Status.SOLVED):.1%}",
        "games per second": f"{1.0 / seconds:.0f}",
        "time per game": yardstick.formatted(seconds),
        "of one `solve`": seconds / alone,
        "of the target rate": 1.0 / seconds / wanted,
        "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
    }


def run(arguments: Arguments) -> list[Result]:
    """The study."""
    games = 256 if arguments.quick else 1024
    rows = [row(horizon, games, threads) for horizon in HORIZONS for threads in (1, 2)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    note = (
        "Crosswalk, 2 players, random games from a cold start, `solve_many`. Times are wall-clock "
        "per game, medians of 5. The target rate, 5000 games/s at T = 10 and 800 at T = 25 on two "
        f"cores, is scaled by the yardstick ({1e3 * REFERENCE_YARDSTICK} ms there). Peak memory of "
        f"the process: {peak:.0f} MiB."
    )
    return [Result("Many games at once", note, rows).show(arguments.console)]
