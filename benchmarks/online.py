"""Online estimation: how long updates take, and how a change of foresight is followed.

All agents re-solve the true game at every step and take its first control; observations are noisy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.stress import cars, driving_game
from benchmarks.timing import Yardstick
from foresight_env.equilibrium import Status, shift, solve
from foresight_env.games import Game, full_state, positions
from foresight_env.inverse import Free, MovingHorizonEstimator, Prior
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting

WINDOW = 10
STEPS = 30
CHANGE = 12
"""Step at which, in the last study, player 1's discount factor changes."""
BEFORE, AFTER = 0.9, 0.45


@dataclass(frozen=True)
class OnlineGame:
    """A game whose parameters are estimated online."""

    name: str
    game: Game
    """Played over its horizon again and again."""
    horizon: int
    """Of the estimated game: the window and what is predicted."""
    std: float
    model: Any
    draw: Callable[[np.random.Generator], tuple[Any, Any, np.ndarray]]
    wanted: float
    """99th percentile of an update, s, on a machine whose yardstick is 2.5 ms."""


class Walk(NamedTuple):
    """One episode's observations and estimates."""

    seconds: list[float]
    gamma: list[float]
    """Inferred of player 1, after each update."""
    deviation: list[float]
    failures: int


def crossing(random: np.random.Generator) -> tuple[Any, Any, np.ndarray]:
    """Two pedestrians."""
    setting = nominal_setting(2)
    states = setting.initial_state + np.pad(random.uniform(-0.2, 0.2, (2, 2)), ((0, 0), (0, 2)))
    return states, list(setting.theta), np.array([0.95, random.uniform(0.3, 1.0)])


def driving(random: np.random.Generator) -> tuple[Any, Any, np.ndarray]:
    """Four cars that meet in the middle."""
    drawn = cars(random, 4, 0)
    return drawn.states, list(drawn.theta), np.append(0.95, random.uniform(0.3, 1.0, 3))


def cases() -> list[OnlineGame]:
    """The crosswalk and four cars, with the noise of the closed-loop studies."""
    walkers, drivers = crosswalk_game(2), driving_game(4, 11, hard=False)
    return [
        OnlineGame("2 pedestrians, T = 25", walkers, 25, 0.05, full_state((4, 4)), crossing, 20e-3),
        OnlineGame("4 cars, T = 11", drivers, 11, 0.1, positions((4,) * 4), driving, 50e-3),
    ]


def estimator(case: OnlineGame) -> MovingHorizonEstimator:
    """Player 0 knows itself and infers goals and discount factors of the others."""
    players = len(case.game.players)
    return MovingHorizonEstimator(
        replace(case.game, horizon=case.horizon),
        case.model,
        (Free((), False, True), *[Free(("goal",), True, True)] * (players - 1)),
        case.std**2,
        WINDOW,
        Prior(gamma_weight=4.0, theta_deviation=(("goal", 3.0),)),
        forgetting_factor=1.5,
    )


def walk(
    case: OnlineGame,
    random: np.random.Generator,
    *,
    change: bool = False,
    dropped: float = 0.0,
    steps: int = STEPS,
) -> Walk:
    """Play, look, estimate; `change` switches player 1's discount factor half-way."""
    states, theta, gamma = case.draw(random)
    made, initial_guess = estimator(case), None
    others = zip(theta[1:], states[1:], strict=True)
    guessed = [theta[0], *({**t, "goal": np.asarray(s[:2])} for t, s in others)]
    belief = made.init(guessed, np.append(gamma[0], np.full(len(gamma) - 1, 0.8)))
    found = Walk([], [], [], 0)
    for k in range(steps):
        if change:
            gamma = np.append(gamma[0], BEFORE if k < CHANGE else AFTER)
        seen = np.asarray(case.model([np.asarray(s) for s in states]), float)
        seen = seen + case.std * random.standard_normal(seen.size)
        if k > 1 and random.random() < dropped:
            seen = np.full(seen.size, np.nan)
        begin = time.perf_counter()
        belief = made.update(belief, seen)
        found.seconds.append(time.perf_counter() - begin)
        found.gamma.append(float(belief.gamma[1]))
        found.deviation.append(float(belief.gamma_deviation[1]))
        played = solve(case.game, states, theta, gamma, initial_guess=initial_guess)
        if int(played.status) != Status.SOLVED:
            break
        initial_guess, states = shift(played), [s[1] for s in played.states]
    return found._replace(failures=belief.failures)


def latency(case: OnlineGame, episodes: int) -> TableRow:
    """Duration of updates, without compilation."""
    random = np.random.default_rng(0)
    walk(case, random)
    yardstick = Yardstick.measure()
    walks = [walk(case, random) for _ in range(episodes)]
    seconds = np.concatenate([w.seconds[2:] for w in walks])
    p50, p90, p99 = np.percentile(seconds, (50, 90, 99))
    return {
        "game": case.name,
        "updates": seconds.size,
        "p50": yardstick.formatted(p50),
        "p90": yardstick.formatted(p90),
        "p99": yardstick.formatted(p99),
        "target p99": f"{1e3 * case.wanted * yardstick.seconds / 2.5e-3:.0f} ms",
        "failed": sum(w.failures for w in walks),
        "yardstick": f"{1e3 * yardstick.seconds:.2f} ms",
    }


def tracking(case: OnlineGame, episodes: int, dropped: float) -> TableRow:
    """Inferred discount factor before and after the true one changes."""
    walks = [
        walk(case, np.random.default_rng([7, k]), change=True, dropped=dropped, steps=CHANGE + 16)
        for k in range(episodes)
    ]
    whole = [w for w in walks if len(w.gamma) == CHANGE + 16]
    gamma = np.array([w.gamma for w in whole]).reshape(len(whole), CHANGE + 16)

    def formatted(values: np.ndarray) -> str:
        low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
        return f"{middle:.2f} [{low:.2f}, {high:.2f}]"

    middle = 0.5 * (BEFORE + AFTER)
    after = gamma[:, CHANGE:] < middle
    steps = np.where(after.any(axis=1), after.argmax(axis=1), after.shape[1])
    return {
        "observations dropped": f"{dropped:.0%}",
        "episodes": len(whole),
        "broken off": episodes - len(whole),
        f"true {BEFORE}": formatted(gamma[:, CHANGE - 1]),
        f"true {AFTER}, 5 steps later": formatted(gamma[:, CHANGE + 5]),
        "10 steps later": formatted(gamma[:, CHANGE + 10]),
        "15 steps later": formatted(gamma[:, CHANGE + 15]),
        "steps to half-way, median": f"{np.median(steps):.0f}",
        "failed updates": sum(w.failures for w in whole),
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has 2 episodes each instead of 40."""
    episodes = 2 if arguments.quick else 40
    both = cases()
    first = (
        f"Window of {WINDOW} observations, {episodes} episodes of {STEPS} steps; the ego infers "
        "goals and discount factors of all others. Updates from the third on; without compilation, "
        "one core. The target is scaled by the yardstick (2.5 ms there)."
    )
    second = (
        f"Crosswalk; player 1's discount factor changes from {BEFORE} to {AFTER} at step {CHANGE}. "
        "Medians over episodes, with 10 and 90 % quantiles. Broken off: the true game failed."
    )
    return [
        Result("Online updates", first, [latency(c, episodes) for c in both]).show(
            arguments.console
        ),
        Result(
            "A discount factor that changes",
            second,
            [tracking(both[0], episodes, dropped) for dropped in (0.0, 0.2)],
        ).show(arguments.console),
    ]
