"""Another library on the same games: NashOpt, which solves the KKT conditions by a root finder.

Its unknowns are controls and multipliers; states follow by the dynamics. The hard proximity is
compared: a soft one has a kink that a root finder for smooth conditions is not made for.
"""

from __future__ import annotations

import time
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.forward import LEAST_GAMMA, TOLERANCE, DrawnStart, draw, is_solved
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import solve
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.rollout import rollout
from foresight_env.equilibrium.verification.verify import player_cost
from foresight_env.games import Game
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

GAMES = {10: 20, 25: 5}
"""Games per horizon; the larger ones take minutes each."""


def nash_problem(game: Game, drawn: DrawnStart) -> Any:
    """The game with NashOpt's words; variables are player 0's controls, then player 1's."""
    from nashopt import GNEP

    layout = layout_of(game)
    parameters = jax.tree.map(
        jnp.asarray, check_parameters(game, drawn.states, MONTE_CARLO.theta, drawn.gamma)
    )
    horizon, players = game.horizon, len(game.players)
    each = layout.m // players

    def trajectory(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        u = jnp.moveaxis(z.reshape(players, horizon, each), 0, 1).reshape(horizon, layout.m)
        return rollout(layout, parameters.initial_state, u), u

    def cost(i: int) -> Any:
        return lambda z: player_cost(layout, i, *trajectory(z), parameters)

    low, high = layout.bounds
    limited = np.isfinite(high[0, : layout.n])
    stages = jnp.arange(1, horizon + 1)

    def above_zero(z: jax.Array) -> jax.Array:
        x, u = trajectory(z)
        w = jnp.concatenate([x, u], axis=1)
        rows = jax.vmap(lambda t, v: layout.constraint_values(t, v, parameters.theta))(stages, w)
        states, least, most = (v[:, : layout.n][:, limited] for v in (x, low, high))
        box = (states - least, most - states)
        return -jnp.concatenate([jnp.ravel(v) for v in (*box, rows)])

    limit = np.asarray(high[:, layout.n :])
    upper = np.concatenate([limit[:, s].ravel() for s in layout.control_slices])
    size = horizon * each
    count = above_zero(jnp.zeros(players * size)).size
    return GNEP(
        [size] * players,
        [cost(i) for i in range(players)],
        g=above_zero,
        ng=count,
        lb=-upper,
        ub=upper,
    )


def rival(game: Game, drawn: DrawnStart) -> tuple[float, float]:
    """Seconds of a second, compiled solve, and the residual that it ends with."""
    with jax.enable_x64(True):
        problem = nash_problem(game, drawn)
        start = np.zeros(problem.nvar)
        problem.solve(x0=start, verbose=0)
        begin = time.perf_counter()
        found = problem.solve(x0=start, verbose=0)
        return time.perf_counter() - begin, float(np.max(np.abs(found.res)))


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has two games of the short horizon."""
    if find_spec("nashopt") is None:
        note = "Left out: NashOpt is not installed (`pip install nashopt`)."
        return [Result("Another library", note, []).show(arguments.console)]
    yardstick = Yardstick.measure()
    rows: list[TableRow] = []
    for horizon, count in {10: 2}.items() if arguments.quick else GAMES.items():
        game = crosswalk_game(2, horizon, "hard")
        times, residuals, own, solved = [], [], [], 0
        for drawn in draw(count, LEAST_GAMMA):
            seconds, residual = rival(game, drawn)
            times.append(seconds)
            residuals.append(residual)

            def ours(drawn: DrawnStart = drawn, game: Game = game) -> Any:
                return solve(game, drawn.states, MONTE_CARLO.theta, drawn.gamma)

            solved += is_solved(ours())
            own.append(median_seconds(ours))
        rows.append(
            {
                "T": horizon,
                "games": count,
                "NashOpt, median": yardstick.formatted(float(np.median(times))),
                "NashOpt solved": int(np.sum(np.array(residuals) <= TOLERANCE)),
                "NashOpt residual, median": f"{np.median(residuals):.1e}",
                "foresight_env, median": yardstick.formatted(float(np.median(own))),
                "foresight_env solved": solved,
                "ratio of times": f"{np.median(times) / np.median(own):.0f}",
            }
        )
    note = (
        f"NashOpt {version('nashopt')}, default method, from the same cold start. Crosswalk "
        "with hard proximity, 2 players, gamma 0.05 to 1. Solved: largest KKT residual at most "
        f"{TOLERANCE:g}, each library's own. Without compile time. {yardstick.note}"
    )
    return [Result("Another library", note, rows).show(arguments.console)]
