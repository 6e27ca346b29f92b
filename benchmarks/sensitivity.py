"""Sensitivity of solver and estimator to their settings, on a fixed development set.

Each setting of the solver is varied alone, each variant solving the same games; the estimator's
settings vary on the same noisy crossings. Counts of steps and solves do not depend on the machine's
speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from benchmarks.merge import draw as draw_merge
from benchmarks.merge import merge_game
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.stress import walkers
from foresight_env.equilibrium import Budget, Solution, SolverOptions, Status, solve, verify
from foresight_env.equilibrium.settings import VerificationSettings
from foresight_env.games import Game, full_state
from foresight_env.highway.scenes import SCENES, draw_driving
from foresight_env.inverse import Estimate, Posterior, Profile, estimate, guess_initial_state
from foresight_env.inverse.settings import EstimatorSettings
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game, player_theta
from foresight_env.scenarios.driving import driving_game
from foresight_env.scenarios.junction import draw_junction, junction_game

GAMES = 12
"""Of each kind; their draws are no benchmark's or study's."""
CHANGE = 0.05
"""Shift of the first initial state's entries from a game to the similar one that a warm solve
begins with, m and m/s."""
HORIZON = 10
"""Of all games but the merge, whose horizon is part of its definition."""
STD = 0.03
"""Noise of the observed crossings, m and m/s."""
CROSSINGS = 4
STEP = 1e-6
"""Of central differences, m and m/s."""


@dataclass(frozen=True)
class Drawn:
    """Games of one kind with their parameters."""

    game: Game
    states: list[np.ndarray]
    thetas: list[Any]
    gammas: list[np.ndarray]

    @cached_property
    def solutions(self) -> list[Solution]:
        """Equilibria by default settings."""
        each = zip(self.states, self.thetas, self.gammas, strict=True)
        return [solve(self.game, *parameters) for parameters in each]


SOLVER: dict[str, tuple[float, ...]] = {
    "exact_below": (1e-3, 0.1),
    "exact_growth": (1.0, 100.0),
    "perturbation": (0.05, 5.0),
    "runaway_multiplier": (1e7, 1e9),
    "violated": (1e-5, 1e-3),
    "softness.equality": (1e-9, 1e-7),
    "softness.least": (1e-11, 1e-9),
    "softness.final": (1e-9, 1e-7),
    "softness.final_residual": (1e-4, 1e-2),
    "path.width": (1e-3, 0.1),
    "path.fraction": (0.9, 0.999),
    "path.corrector_end": (1.0, 100.0),
    "path.end_width": (1e-3, 0.1),
    "path.least_slack": (0.01, 1.0),
    "path.most_share": (0.05, 0.95),
}
NONLINEAR: dict[str, tuple[float, ...]] = {
    "convexification.fall": (0.4, 0.95),
    "convexification.rise": (2.0, 200.0),
    "convexification.restart": (2e-4, 2e-2),
    "convexification.sign_steps": (5, 20),
    "damping.raised": (2.0, 200.0),
    "damping.begin": (0.1, 10.0),
    "damping.end": (0.05, 5.0),
}
"""Settings that only games with nonlinear dynamics or rejected steps read."""
WARM: dict[str, tuple[float, ...]] = {
    "semismooth_steps": (5, 20),
    "semismooth_trial": (1, 6),
    "warm_steps": (20, 90),
    "warm_barrier": (1e-3, 0.1),
    "warm_exactness": (1.0, 100.0),
    "path.warm_margin": (1e-4, 1e-2),
}
STEPS = (15, 25, 40, 80)
"""Newton steps of a single phase, as budgets grant them."""
DERIVATIVES: dict[str, tuple[float, ...]] = {
    "softness.tangent": (1e-6, 1e-4),
    "softness.tangent_corrections": (0, 4),
}
VERIFICATION: dict[str, tuple[float, ...]] = {
    "stiffness": (1e3, 1e5),
    "perturbation": (1e-4, 1e-2),
    "rounding": (1e-7, 1e-5),
}
ESTIMATOR: dict[str, tuple[float, ...]] = {
    "search.stalls": (1, 4),
    "search.smooth_tolerance": (3e-3, 0.3),
    "search.damping": (0.03, 3.0),
    "search.phase_damping": (1e-3, 0.1),
    "search.pull": (1e-3, 0.1),
    "search.too_far": (3.0, 300.0),
    "search.falls": (0.02, 0.5),
    "search.rises": (2.0, 60.0),
    "search.rises_much": (6.0, 360.0),
    "search.least_damping": (1e-10, 1e-8),
    "search.tracking_solves": (1, 6),
    "search.same_cost": (1e-3, 0.1),
    "search.plausible": (1.0, 9.0),
    "tracking.effort": (0.01, 1.0),
    "tracking.scale": (1.0, 100.0),
    "tracking.inverse_steps": (2, 10),
    "tracking.kept": (1e-4, 1e-2),
    "tracking.accuracy": (1e-5, 1e-3),
}
SMOOTHED: dict[str, tuple[float, ...]] = {"path.smoothed_tolerance": (1e-4, 1e-2)}
"""Settings of the solver that only smoothed games of fits read."""
PROFILE: dict[str, tuple[float, ...]] = {
    "walk.narrowest": (5e-4, 5e-2),
    "walk.widest": (0.1, 0.5),
    "walk.growth": (1.5, 6.0),
    "walk.close": (0.015, 0.5),
    "walk.better": (0.01, 1.0),
    "walk.tolerance": (1e-4, 1e-2),
    "walk.from_smoothed": (1, 6),
    "walk.renewals": (0, 6),
}
POSTERIOR: dict[str, tuple[float, ...]] = {
    "sampling.first_deviation": (1.0, 4.0),
    "sampling.close": (0.01, 1.0),
    "sampling.tolerance": (1e-4, 1e-2),
    "sampling.ridge": (1e-7, 1e-5),
    "sampling.negligible": (1e-7, 1e-5),
    "sampling.proposal.freedom": (2.0, 50.0),
    "sampling.proposal.least_deviation": (1e-5, 1e-3),
    "sampling.proposal.most_deviation": (0.25, 1.0),
    "sampling.proposal.correlation": (0.5, 1.0),
    "sampling.proposal.flattest": (1e-4, 1e-2),
    "sampling.proposal.wider": (1.0, 2.0),
    "sampling.proposal.candidates": (1024, 16384),
    "sampling.gibbs.sweeps": (60, 480),
    "sampling.gibbs.burn_in": (2, 60),
    "sampling.gibbs.chains": (2, 32),
}


def value_of(settings: Any, path: str) -> Any:
    """Return a setting by its dotted path."""
    for name in path.split("."):
        settings = getattr(settings, name)
    return settings


def with_value(settings: Any, path: str, value: Any) -> Any:
    """Return frozen settings with one of them, given by its dotted path, changed."""
    name, _, rest = path.partition(".")
    changed = with_value(getattr(settings, name), rest, value) if rest else value
    return replace(settings, **{name: changed})


def variants(
    settings: Any, values: dict[str, tuple[float, ...]], quick: bool
) -> Iterator[tuple[str, str, Any]]:
    """Names, values and settings, those by default first."""
    yield "as by default", "", settings
    for path, others in list(values.items())[: 2 if quick else None]:
        for value in others:
            changed = f"{value:g}, not {value_of(settings, path):g}"
            yield path, changed, with_value(settings, path, value)


def development_set(games: int) -> dict[str, Drawn]:
    """The games by kind; the same every time."""
    random = np.random.default_rng(20_251)
    found = {}
    drawn: list[Any] = [walkers(random, 2, k) for k in range(games)]
    found["crosswalk"] = Drawn(
        crosswalk_game(2, HORIZON),
        [d.states for d in drawn],
        [d.theta for d in drawn],
        [d.gamma for d in drawn],
    )
    found["merge"] = Drawn(
        merge_game(2),
        [draw_merge(2, 9_000 + k) for k in range(games)],
        [[{}, {}]] * games,
        [np.ones(2)] * games,
    )
    turn = SCENES["left_turn"]
    for name, game, episodes in (
        (
            "left turn",
            driving_game(2, HORIZON),
            [draw_driving(random, turn, 2) for _ in range(games)],
        ),
        (
            "junction",
            junction_game(1, 1, HORIZON),
            [draw_junction(random, 1, 1) for _ in range(games)],
        ),
    ):
        found[name] = Drawn(
            game,
            [e.initial_state for e in episodes],
            [e.theta for e in episodes],
            [e.gamma for e in episodes],
        )
    return found


def solved_cell(found: Sequence[Solution]) -> str:
    """Solved games of all, and the mean of all games' Newton steps."""
    solved = sum(int(s.status) == Status.SOLVED for s in found)
    steps = float(np.mean([int(s.iterations) for s in found]))
    return f"{solved}/{len(found)}, {steps:.1f}"


def cold(drawn: Drawn, options: SolverOptions, budget: Budget = Budget()) -> str:
    """Cold solves of all games of a kind."""
    each = zip(drawn.states, drawn.thetas, drawn.gammas, strict=True)
    return solved_cell([solve(drawn.game, *e, options=options, budget=budget) for e in each])


def warm(drawn: Drawn, options: SolverOptions) -> str:
    """Solves from the solution, by default settings, of the game before a shift of its state."""
    found = []
    each = zip(drawn.states, drawn.thetas, drawn.gammas, drawn.solutions, strict=True)
    for states, theta, gamma, near in each:
        moved = np.array(states, float)
        moved[0, :3] += CHANGE
        found.append(solve(drawn.game, moved, theta, gamma, initial_guess=near, options=options))
    return solved_cell(found)


def solver_rows(
    values: dict[str, tuple[float, ...]],
    kinds: dict[str, Drawn],
    count: Callable[[Drawn, SolverOptions], str],
    quick: bool,
) -> list[TableRow]:
    """One line per variant, one column per kind of game."""
    rows: list[TableRow] = []
    for name, value, options in variants(SolverOptions(), values, quick):
        cells = {kind: count(drawn, options) for kind, drawn in kinds.items()}
        rows.append({"setting": name, "value": value, **cells})
        jax.clear_caches()  # dozens of programs exhaust XLA's memory for code
    return rows


def derivative_row(options: SolverOptions) -> dict[str, str | int | float]:
    """Largest difference of derivatives from central differences, relative to the largest."""
    game, at = crosswalk_game(2, HORIZON), MONTE_CARLO

    def first(states: Any) -> Any:
        found = solve(game, states, at.theta, at.gamma, options=options)
        return found.states[0]

    begin = np.asarray(at.initial_state, float)
    exact = np.asarray(jax.jacfwd(first)(begin))
    worst = 0.0
    for i, j in np.ndindex(*begin.shape):
        away = np.zeros_like(begin)
        away[i, j] = STEP
        rough = (np.asarray(first(begin + away)) - np.asarray(first(begin - away))) / (2.0 * STEP)
        worst = max(worst, float(np.max(np.abs(exact[..., i, j] - rough))))
    return {"relative error": f"{worst / float(np.max(np.abs(exact))):.1e}"}


def verified_row(drawn: Drawn, settings: VerificationSettings) -> dict[str, str | int | float]:
    """Solutions that `verify` confirms."""
    confirmed = solved = 0
    each = zip(drawn.thetas, drawn.gammas, drawn.solutions, strict=True)
    for theta, gamma, found in each:
        if int(found.status) == Status.SOLVED:
            solved += 1
            checked = verify(drawn.game, found, theta, gamma, settings=settings)
            confirmed += bool(checked.is_local_equilibrium)
    return {"confirmed": f"{confirmed}/{solved}"}


def crossings(count: int) -> list[np.ndarray]:
    """Noisy observations of the published crossing."""
    at = MONTE_CARLO
    found = solve(crosswalk_game(2, HORIZON), at.initial_state, at.theta, at.gamma, throw=True)
    clean = np.concatenate(found.states, axis=1)
    random = np.random.default_rng(20_252)
    return [clean + STD * random.standard_normal(clean.shape) for _ in range(count)]


def fits(seen: Sequence[np.ndarray], **settings: Any) -> list[Estimate]:
    """Fits of discount factors and initial states to crossings."""
    game, model = crosswalk_game(2, HORIZON), full_state((4, 4))
    return [
        estimate(
            game,
            values,
            model,
            initial_state=guess_initial_state(game, model, values),
            theta=[player_theta(goal) for goal in MONTE_CARLO.goals],
            gamma=[0.7, 0.7],
            covariance=STD**2,
            **settings,
        )
        for values in seen
    ]


def estimator_row(found: Sequence[Estimate]) -> dict[str, str | int | float]:
    """Means over crossings: objective, error of the discount factors, forward solves, intervals."""
    error = np.mean([np.abs(e.gamma - MONTE_CARLO.gamma) for e in found])
    width = np.mean([np.diff(e.gamma_interval, axis=1) for e in found])
    return {
        "objective": f"{np.mean([float(e.cost) for e in found]):.3f}",
        "error of gamma": f"{error:.4f}",
        "forward solves": f"{np.mean([int(e.num_forward_solves) for e in found]):.1f}",
        "width of intervals": f"{width:.4f}",
    }


def settings_rows(
    settings: Any,
    values: dict[str, tuple[float, ...]],
    row: Callable[[Any], dict[str, str | int | float]],
    quick: bool,
    recompiles: bool = True,
) -> list[TableRow]:
    """One line per variant; `recompiles`: no two variants share a compiled program."""
    rows: list[TableRow] = []
    for name, value, changed in variants(settings, values, quick):
        rows.append({"setting": name, "value": value, **row(changed)})
        if recompiles:
            jax.clear_caches()
    return rows


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` takes fewer games and two settings of each kind."""
    quick = arguments.quick
    kinds = development_set(3 if quick else GAMES)

    def only(*names: str) -> dict[str, Drawn]:
        return {name: kinds[name] for name in names}

    seen = crossings(2 if quick else CROSSINGS)
    solves = "Solved games of all, and the mean of all games' Newton steps."
    budgets: list[TableRow] = []
    for steps in STEPS:
        budget = Budget(phases=1, newton_steps=steps)
        cells = {k: cold(d, SolverOptions(), budget) for k, d in kinds.items()}
        budgets.append({"Newton steps": str(steps), **cells})
    averages = "Means over the same noisy crossings; forward solves include failed ones."
    results = [
        Result("Sensitivity: budgets", f"One cold phase. {solves}", budgets),
        Result(
            "Sensitivity: cold solves",
            f"One setting changed at a time. {solves}",
            solver_rows(SOLVER, only("crosswalk", "merge", "junction"), cold, quick),
        ),
        Result(
            "Sensitivity: cold solves with nonlinear dynamics",
            f"As before. {solves}",
            solver_rows(NONLINEAR, only("left turn", "junction"), cold, quick),
        ),
        Result(
            "Sensitivity: warm solves",
            f"From the solution of the game whose first state is {CHANGE:g} m away. {solves}",
            solver_rows(WARM, only("crosswalk", "left turn"), warm, quick),
        ),
        Result(
            "Sensitivity: derivatives",
            "Against central differences of the published crossing, relative to the largest.",
            settings_rows(SolverOptions(), DERIVATIVES, derivative_row, quick),
        ),
        Result(
            "Sensitivity: verification",
            "Equilibria of the crosswalk that `verify` confirms.",
            settings_rows(
                VerificationSettings(),
                VERIFICATION,
                lambda s: verified_row(kinds["crosswalk"], s),
                quick,
            ),
        ),
        Result(
            "Sensitivity: estimates",
            averages,
            [
                *settings_rows(
                    EstimatorSettings(),
                    ESTIMATOR,
                    lambda s: estimator_row(fits(seen, settings=s)),
                    quick,
                ),
                *settings_rows(
                    SolverOptions(),
                    SMOOTHED,
                    lambda o: estimator_row(fits(seen, options=o)),
                    quick,
                )[1:],
            ],
        ),
        Result(
            "Sensitivity: profiles",
            averages,
            settings_rows(
                Profile(), PROFILE, lambda p: estimator_row(fits(seen, profile=p)), quick, False
            ),
        ),
        Result(
            "Sensitivity: posterior means",
            averages,
            settings_rows(
                Posterior(samples=32),
                POSTERIOR,
                lambda p: estimator_row(fits(seen, posterior=p)),
                quick,
                False,
            ),
        ),
    ]
    return [result.show(arguments.console) for result in results]
