"""Reliability: random games of many kinds, from a cold start; every failure by its label."""

from __future__ import annotations

import runpy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import ROOT
from foresight_env.equilibrium import Solution, Status, solve_many, verify
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    KinematicBicycle,
    Lane,
    LaneCenter,
    MinimumDistance,
    Player,
    SharedInequality,
    SharedMinimumDistance,
    SigmoidProximity,
    SquaredDistanceHinge,
    TargetSpeed,
)
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting, player_theta

SITUATIONS = ("crossing", "head-on", "inside the margin", "goal beyond reach")
GAMMA = (0.01, 1.1)
GAMMA_UNDISCOUNTED = (0.7, 1.1)
"""An undiscounted cost weighs `gamma**-t` relative to the others: no scaling suits small gammas."""


class DrawnGame(NamedTuple):
    """One random game of a class."""

    states: np.ndarray
    theta: Sequence[dict[str, Any]]
    gamma: np.ndarray
    arrangement: str


@dataclass(frozen=True)
class GameFamily:
    """A kind of game: how it is made for (players, horizon), how situations are drawn."""

    name: str
    make: Callable[[int, int], Game]
    draw: Callable[[np.random.Generator, int, int], DrawnGame]
    sizes: tuple[tuple[int, int], ...]


def places(random: np.random.Generator, players: int, arrangement: str) -> tuple[Any, Any]:
    """Starts and goals (N, 2) of people or cars that meet in the middle."""
    nominal = nominal_setting(players)
    start = nominal.initial_state[:, :2] + random.uniform(-0.3, 0.3, (players, 2))
    goal = nominal.goals + random.uniform(-0.3, 0.3, (players, 2))
    if arrangement == "head-on":
        start[:2] = [[0.0, 1.0], [2.0, 1.0 + random.uniform(-0.02, 0.02)]]
        goal[:2] = [[2.0, 1.0], [0.0, 1.0]]
    elif arrangement == "inside the margin":
        start[1] = start[0] + random.uniform(-0.3, 0.3, 2)
    elif arrangement == "goal beyond reach":
        goal = 10.0 * goal - 9.0
    return start, goal


def walkers(random: np.random.Generator, players: int, k: int, *, gamma: Any = GAMMA) -> DrawnGame:
    """Double integrators that start at any speed within their limits."""
    arrangement = SITUATIONS[k % len(SITUATIONS)]
    start, goal = places(random, players, arrangement)
    states = np.concatenate([start, random.uniform(-0.8, 0.8, (players, 2))], axis=1)
    return DrawnGame(
        states, [player_theta(g) for g in goal], random.uniform(*gamma, players), arrangement
    )


def cars(random: np.random.Generator, players: int, k: int, *, scale: float = 4.0) -> DrawnGame:
    """Bicycles that drive towards their goals, up to 0.3 rad off."""
    arrangement = SITUATIONS[k % len(SITUATIONS)]
    start, goal = (scale * v for v in places(random, players, arrangement))
    heading = np.arctan2(*(goal - start).T[::-1]) + random.uniform(-0.3, 0.3, players)
    speed = random.uniform(0.5, 4.0, players)
    states = np.concatenate([start, speed[:, None], heading[:, None]], axis=1)
    theta = [{"goal": g, "speed": v} for g, v in zip(goal, speed, strict=True)]
    return DrawnGame(states, theta, random.uniform(*GAMMA, players), arrangement)


def walking_game(players: int, horizon: int, *, sigmoid: bool) -> Game:
    """Squared hinge or sigmoid proximity, discounted like everything else."""
    near = SigmoidProximity(0.8, 2.0) if sigmoid else SquaredDistanceHinge(1.2, 5.0)
    free = np.inf
    player = Player(
        DoubleIntegrator(0.1),
        (Goal("goal_weight"), Effort("control_weight"), near),
        state_bounds=Bounds.box([-free, -free, -0.8, -0.8], [free, free, 0.8, 0.8], 4),
        control_bounds=Bounds.box(-2.0, 2.0, 2),
        extra_theta=("collision_weight",),
    )
    return Game((player,) * players, horizon)


def driver(*costs: Any, **more: Any) -> Player:
    """A car that neither reverses nor turns on the spot."""
    free = np.inf
    return Player(
        KinematicBicycle(0.1, 2.5),
        costs,
        state_bounds=Bounds.box([-free, -free, 0.0, -free], [free, free, 8.0, free], 4),
        control_bounds=Bounds.box([-6.0, -0.6], [4.0, 0.6], 2),
        extra_theta=("goal", "speed"),
        **more,
    )


def driving_game(players: int, horizon: int, *, hard: bool) -> Game:
    """Cars to goals: a hinge between them, or a shared constraint."""
    shared = (
        (SharedInequality(SharedMinimumDistance(4.0), players * (players - 1) // 2),)
        if hard
        else ()
    )
    near = () if hard else (SquaredDistanceHinge(3.0, 5.0),)
    return Game((driver(Goal(0.1), Effort(0.5), *near),) * players, horizon, shared)


def lane_game(players: int, horizon: int) -> Game:
    """One lane per car, crossing under an angle; elastic collision cost."""
    made = []
    for i in range(players):
        lane = LaneCenter(Lane((0.3 * (-1) ** i, 0.0)))
        apart = Inequality(MinimumDistance(4.0), players - 1, 20.0)
        made.append(driver(lane, TargetSpeed("speed"), Effort(0.5), inequalities=(apart,)))
    return Game(tuple(made), horizon)


def mixed_game(players: int, horizon: int) -> Game:
    """Every other agent is a car, the rest walk; hinges between all."""
    near = SquaredDistanceHinge(2.0, 5.0)
    walker = Player(
        DoubleIntegrator(0.1),
        (Goal(), Effort(0.1), near),
        control_bounds=Bounds.box(-3.0, 3.0, 2),
        extra_theta=("speed",),
    )
    car = driver(Goal(0.1), Effort(0.5), near)
    return Game(tuple(walker if i % 2 else car for i in range(players)), horizon)


def mixed(random: np.random.Generator, players: int, k: int) -> DrawnGame:
    """As `cars`, with velocities instead of speed and heading for those who walk."""
    drawn = cars(random, players, k, scale=2.0)
    states = drawn.states.copy()
    states[1::2, 2:] = random.uniform(-1.0, 1.0, states[1::2, 2:].shape)
    return drawn._replace(states=states)


def families() -> list[GameFamily]:
    """All of them; the lane change is the example's."""
    example = runpy.run_path(str(ROOT / "examples" / "own_game.py"))

    def lane_change(random: np.random.Generator, players: int, k: int) -> DrawnGame:
        return DrawnGame(*example["draw"](random), "lane change")

    small, large = ((2, 5), (2, 25), (4, 10), (6, 10)), ((2, 10), (3, 25), (2, 50))
    undiscounted = partial(walkers, gamma=GAMMA_UNDISCOUNTED)
    return [
        GameFamily(
            "lane change, shared constraint",
            lambda n, t: example["lane_change"](t),
            lane_change,
            tuple((2, t) for t in (10, 20, 30, 40, 50)),
        ),
        GameFamily("walkers, elastic", crosswalk_game, walkers, (*small, *large)),
        GameFamily(
            "walkers, shared constraint", partial(crosswalk_game, proximity="hard"), walkers, small
        ),
        GameFamily("walkers, squared hinge", partial(walking_game, sigmoid=False), walkers, small),
        GameFamily("walkers, sigmoid", partial(walking_game, sigmoid=True), walkers, small),
        GameFamily(
            "walkers, undiscounted hinge",
            partial(crosswalk_game, proximity="reference"),
            undiscounted,
            ((2, 10), (2, 25)),
        ),
        GameFamily("cars, squared hinge", partial(driving_game, hard=False), cars, small),
        GameFamily("cars, shared constraint", partial(driving_game, hard=True), cars, small),
        GameFamily("cars on lanes, elastic", lane_game, cars, small),
        GameFamily("cars and walkers, squared hinge", mixed_game, mixed, small),
    ]


def first_stage(bounds: Bounds | None, size: int) -> np.ndarray:
    """Lower and upper bounds at the first stage, (2, size); infinite where there are none."""
    box = bounds or Bounds.box(-np.inf, np.inf, size)
    return np.array([box.lower[0], box.upper[0]])


def proven_infeasible(game: Game, drawn: DrawnGame) -> bool:
    """Whether two agents are too close at `x_2` whatever they do: then no solution exists.

    `x_2`'s positions lie in boxes that bounds of controls and speeds give; two boxes whose
    farthest points are closer than the constraint's distance cannot satisfy it. Says nothing
    (False) of later stages and of games without a shared constraint of distance.
    """
    threshold = max(
        (
            s.function.threshold
            for s in game.shared
            if isinstance(s.function, SharedMinimumDistance)
        ),
        default=-np.inf,
    )
    high = np.full((len(game.players), 2), np.inf)
    low = -high
    for i, (player, state) in enumerate(zip(game.players, drawn.states, strict=True)):
        dt = player.dynamics.dt
        if isinstance(player.dynamics, KinematicBicycle):
            ahead = state[2] * np.array([np.cos(state[3]), np.sin(state[3])])
            low[i] = high[i] = state[:2] + dt * ahead  # no control acts on it yet
        elif isinstance(player.dynamics, DoubleIntegrator):
            force = first_stage(player.control_bounds, 2)
            limit = first_stage(player.state_bounds, 4)
            for side, best, box in ((0, np.maximum, low), (1, np.minimum, high)):
                speed = best(state[2:] + dt * force[side], limit[side, 2:])
                box[i] = state[:2] + 0.5 * dt * (state[2:] + speed)
    return any(
        np.sum(np.maximum(np.abs(high[i] - low[j]), np.abs(high[j] - low[i])) ** 2) < threshold
        for i, j in combinations(range(len(game.players)), 2)
    )


def situation_rows(name: str, size: tuple[int, int], drawn: Sequence[DrawnGame], found: Solution,
                   proven: np.ndarray, verified: np.ndarray | None) -> list[TableRow]:  # fmt: skip
    """One line per arrangement of a class of games."""
    rows: list[TableRow] = []
    situations = np.array([d.arrangement for d in drawn])
    for arrangement in dict.fromkeys(situations):
        mine = situations == arrangement
        status = found.status[mine]
        solved, infeasible = status == Status.SOLVED, status == Status.INFEASIBLE
        iterations = found.iterations[mine]
        rows.append(
            {
                "game": name,
                "N": str(size[0]),
                "T": str(size[1]),
                "arrangement": str(arrangement),
                "games": str(mine.sum()),
                "solved": f"{solved.mean():.1%}",
                "infeasible": str(infeasible.sum()),
                "of them proven": str((infeasible & proven[mine]).sum()),
                "other failures": str((~solved & ~infeasible).sum()),
                "local equilibria": f"{verified[mine][solved].mean():.1%}"
                if solved.any() and verified is not None
                else "-",
                "iterations, median, p95": f"{np.median(iterations):.0f}, "
                f"{np.percentile(iterations, 95):.0f}",
            }
        )
    return rows


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` draws a tenth of the games and verifies none."""
    count = 16 if arguments.quick else 128
    rows: list[TableRow] = []
    total = solved = infeasible = unproven = not_finite = 0
    for family in families():
        for size in family.sizes:
            with arguments.console.status(f"{family.name}, N = {size[0]}, T = {size[1]}"):
                jax.clear_caches()  # dozens of compiled classes exhaust XLA's memory for code
                game = family.make(*size)
                random = np.random.default_rng([*size, len(family.name)])
                drawn = [family.draw(random, size[0], k) for k in range(count)]
                found = solve_many(
                    game,
                    np.stack([d.states.ravel() for d in drawn]),
                    [d.theta for d in drawn],
                    np.stack([d.gamma for d in drawn]),
                )
                good = found.status == Status.SOLVED
                verified = np.zeros(count, bool)
                for k in np.flatnonzero(good) if not arguments.quick else ():
                    one: Solution = jax.tree.map(lambda v, k=k: v[k], found)
                    checked = verify(game, one, drawn[k].theta, drawn[k].gamma)
                    verified[k] = checked.is_local_equilibrium
            finite = np.isfinite(np.concatenate(found.states, axis=2)).all(axis=(1, 2))
            not_finite += int((good & ~finite).sum())
            total += count
            solved += int(good.sum())
            labelled = found.status == Status.INFEASIBLE
            proven = np.array([proven_infeasible(game, d) for d in drawn])
            if (good & proven).any():
                raise AssertionError(f"{family.name}: solved, and proven to have no solution")
            infeasible += int(labelled.sum())
            unproven += int((labelled & ~proven).sum())
            rows += situation_rows(
                family.name, size, drawn, found, proven, None if arguments.quick else verified
            )
    note = (
        f"{total} random games, gamma uniform in {GAMMA} (undiscounted hinge: "
        f"{GAMMA_UNDISCOUNTED}), cold, tolerance 1e-8. Solved: {solved / total:.2%} of all, "
        f"{solved / (total - infeasible):.2%} of those not labelled infeasible. {infeasible} are "
        f"labelled so; it is proven for all but {unproven} of them, since two agents are too close "
        f"after one step whatever they do. {not_finite} of the solved hold a number that is not "
        "finite. Local equilibria: of the solved, by `verify`"
        + (" (not measured with --quick)." if arguments.quick else ".")
    )
    return [Result("Reliability", note, rows).show(arguments.console)]
