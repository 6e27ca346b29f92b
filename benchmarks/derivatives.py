"""Derivatives through a solve: right over all kinds of games, and what they cost."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.stress import DrawnGame, GameFamily, families
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import WEAK_COMPLEMENTARITY, Solution, SolverOptions, Status, solve
from foresight_env.games import Game
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

STEP = 1e-6
"""Of the central differences."""
TIGHT = SolverOptions(tolerance=1e-11)
ACCURATE = 1e-5
"""Largest error, relative to the largest rate, at which a derivative counts as right."""


class Ray(NamedTuple):
    """A game's parameters and a direction to move them in."""

    initial_state: Any
    theta: Any
    gamma: Any
    direction: Any

    def at(self, step: Any) -> tuple[Any, Any, Any]:
        """The parameters a step along the direction."""
        return jax.tree.map(lambda v, d: v + step * d, tuple(self[:3]), self.direction)


def ray(drawn: DrawnGame, random: np.random.Generator) -> Ray:
    """A random direction for everything that a game's equilibrium depends on."""
    parts = jax.tree.map(
        lambda v: np.asarray(v, float), (drawn.states, list(drawn.theta), drawn.gamma)
    )
    return Ray(*parts, jax.tree.map(lambda v: random.normal(size=np.shape(v)), parts))


def trajectory(found: Solution) -> Any:
    """States that were solved for and controls, as one vector."""
    xp: Any = np if isinstance(found.residual, np.ndarray) else jnp
    return xp.concatenate([xp.ravel(v) for v in (*(s[1:] for s in found.states), *found.controls)])


@partial(jax.jit, static_argnums=0)
def rate(game: Game, along: Ray) -> Float[Array, "r"]:
    """The implicit derivative."""

    def moved(step: Array) -> Array:
        return trajectory(solve(game, *along.at(step), options=TIGHT))

    return jax.jvp(moved, (jnp.zeros(()),), (jnp.ones(()),))[1]


def difference(game: Game, along: Ray, found: Solution) -> Float[np.ndarray, "r"] | None:
    """The central difference; None where a neighbour is not solved."""
    ends = []
    for step in (STEP, -STEP):
        near = solve(game, *along.at(step), initial_guess=found, options=TIGHT)
        if int(near.status) != Status.SOLVED:
            return None
        ends.append(trajectory(near))
    return np.asarray(ends[0] - ends[1]) / (2.0 * STEP)


def row(family: GameFamily, size: tuple[int, int], count: int) -> TableRow:
    """One class of games of the stress set."""
    game = family.make(*size)
    random = np.random.default_rng([*size, len(family.name), 1])
    errors, weak, unsolved = [], 0, 0
    for k in range(count):
        along = ray(family.draw(random, size[0], k), random)
        found = solve(game, *along.at(0.0), options=TIGHT)
        if int(found.status) != Status.SOLVED:
            unsolved += 1
        elif float(found.margin) < WEAK_COMPLEMENTARITY:
            weak += 1
        elif (expected := difference(game, along, found)) is None:
            unsolved += 1
        else:
            with jax.enable_x64(True):
                exact = np.asarray(rate(game, along))
            errors.append(np.abs(exact - expected).max() / np.abs(expected).max())
    return {
        "game": family.name,
        "N": size[0],
        "T": size[1],
        "games": count,
        "unsolved": unsolved,
        "flagged": weak,
        "compared": len(errors),
        f"within {ACCURATE:g}": f"{np.mean(np.array(errors) <= ACCURATE):.0%}" if errors else "-",
        "median error": f"{np.median(errors):.0e}" if errors else "-",
        "largest error": f"{np.max(errors):.0e}" if errors else "-",
    }


def costs() -> list[TableRow]:
    """Seconds of derivatives, compared with those of the solve alone, crosswalk, T = 25."""
    game, setting = crosswalk_game(2, 25), MONTE_CARLO
    with jax.enable_x64(True):
        states = jnp.asarray(setting.initial_state)
        goals, gamma = jnp.asarray(setting.goals), jnp.asarray(setting.gamma)
        point = jnp.concatenate([states.ravel(), goals.ravel(), gamma])

        def moved(v: Array) -> Array:
            theta = [{**t, "goal": v[8 + 2 * i : 10 + 2 * i]} for i, t in enumerate(setting.theta)]
            return trajectory(solve(game, v[:8].reshape(2, 4), theta, v[12:]))

        one = jnp.ones_like(point)
        iterations = int(solve(game, setting.initial_state, setting.theta, gamma).iterations)
        programs = {
            "the solve alone": jax.jit(moved),
            "and one forward derivative": jax.jit(lambda v: jax.jvp(moved, (v,), (one,))),
            "and one reverse derivative": jax.jit(jax.value_and_grad(lambda v: jnp.sum(moved(v)))),
            "and all 14, forward": jax.jit(jax.jacfwd(lambda v: (moved(v),) * 2, has_aux=True)),
        }
        seconds = {}
        for name, program in programs.items():
            call = partial(lambda p: jax.block_until_ready(p(point)), program)
            call()
            seconds[name] = median_seconds(call, 51)
    alone = seconds["the solve alone"]
    yardstick = Yardstick.measure()
    return [
        {
            "program": name,
            "time": yardstick.formatted(value),
            "more than the solve": f"{value / alone - 1.0:.0%}",
            "in Newton steps": f"{iterations * (value / alone - 1.0):.1f}",
        }
        for name, value in seconds.items()
    ]


def run(arguments: Arguments) -> list[Result]:
    """The study: the first and the last size of each family; `quick` leaves out the latter."""
    count = 4 if arguments.quick else 16
    rows = []
    for family in families():
        for size in family.sizes[:1] if arguments.quick else (family.sizes[0], family.sizes[-1]):
            with arguments.console.status(f"{family.name}, N = {size[0]}, T = {size[1]}"):
                jax.clear_caches()  # dozens of compiled classes exhaust XLA's memory for code
                rows.append(row(family, size, count))
    note = (
        "The stress set's games, tolerance 1e-11; rates of all states and controls along a random "
        f"direction of x_1, theta and gamma, against central differences (step {STEP:g}), relative "
        "to the largest rate. Flagged: `margin` below "
        f"{WEAK_COMPLEMENTARITY:g}, where the derivative is that of the smoothed problem and "
        "differences straddle a change of the active set."
    )
    price = (
        "Crosswalk, 2 players, T = 25, compiled as a whole; derivatives by initial states, goals "
        "and discount factors. A factorisation is a part of a Newton step."
    )
    return [
        Result("Derivatives", note, rows).show(arguments.console),
        Result("What derivatives cost", price, costs()).show(arguments.console),
    ]
