"""The scene's own game as a predictor: inferred discount factors, goals, speeds and states.

For places whose game is known, as those of the environments (`History.context.game`). The game
between all agents, the observer among them, is fitted to the history; then the agents play it as
they do in the environment, re-planning at every step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History, SceneGame
from agents.predictors.encounter_fit import seen_states
from agents.predictors.equilibrium_forecast import (
    LEAST_STEPS,
    covariance_of,
    straight_on,
    wandering,
)
from foresight_env.equilibrium import Solution, Status, shift, solve
from foresight_env.games import Game, full_state, inside_bounds
from foresight_env.inverse import (
    Estimate,
    Free,
    MultiStart,
    Prior,
    estimate,
    guess_initial_state,
)

LEAST_VARIANCE = 1e-6
"""Variance that noise-free observations are given, m^2: that of the egos' estimates."""
WANDER = 0.05
"""Density of the white acceleration by which agents depart from the fitted equilibrium, m^2/s^3:
they re-plan, and may play another one. Chosen by the likelihood on development seeds."""
LEAST_SPREAD = 0.01
"""Least standard deviation of the prior of discount factors."""
MISSED_STEP = 1e-6
"""By how much (s) a step of the history may differ from a multiple of the game's."""


@dataclass(frozen=True)
class SceneGamePredictor:
    """Fit of the scene's game to the history, and its continuation by re-planning agents."""

    infer: bool = True
    """Whether discount factors are inferred; else they are 1."""

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return "scene-game" if self.infer else "scene-game-gamma-1"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; constant velocity as a fallback where no fit succeeds.

        Raises:
            ValueError: the history has no game, or one of other agents or with other steps.
        """
        known = scene_game_of(history)
        if len(history.states) < LEAST_STEPS:
            return straight_on(history, steps)
        every = steps_between(history, known.game)
        found = self.fit(history, steps)
        if int(found.status) != Status.SOLVED:
            return straight_on(history, steps)
        now = every * (len(history.states) - 1)
        path = replanned(known.game, found, now, every * steps)
        rows = now + every * np.arange(1, steps + 1)
        return Forecast(
            path[every - 1 :: every][None],
            np.ones(1),
            (covariance_of(found, rows) + wandering(WANDER, WANDER, history, steps))[None],
            found.gamma,
            found.gamma_deviation,
            found.gamma_identifiable,
        )

    def fit(self, history: History, steps: int) -> Estimate:
        """Return the estimate behind the forecast, in steps of the game; check its status.

        It covers the history, and after it the agents' planning horizon or `steps` steps of the
        history, whichever is longer.
        """
        known = scene_game_of(history)
        every = steps_between(history, known.game)
        rows = every * (len(history.states) - 1) + 1
        ahead = max(known.game.horizon, every * steps)
        game = replace(known.game, horizon=rows - 1 + ahead)
        model = full_state(game.state_sizes)
        observations = np.full((rows, model.size), np.nan)
        observations[::every] = seen_states(history).reshape(len(history.states), -1)
        low, high = known.population.gamma
        names = tuple(name for name, _ in known.population.deviation)
        # Mean and standard deviation of a uniform distribution.
        center, spread = 0.5 * (low + high), (high - low) / math.sqrt(12.0)
        prior = Prior(1.0 / max(spread, LEAST_SPREAD) ** 2, center, known.population.deviation)
        initial = inside_bounds(game, guess_initial_state(game, model, observations))
        theta = known.population.theta
        gamma = np.full(len(game.players), center if self.infer else 1.0)
        fit = partial(
            estimate,
            game,
            observations,
            model,
            initial_state=initial,
            theta=theta,
            gamma=gamma,
            free=Free(names, self.infer, True),
            covariance=max(known.noise_std**2, LEAST_VARIANCE),
            prior=prior,
            starts=MultiStart(1),
        )
        found = fit()
        if int(found.status) == Status.SOLVED:
            return found
        # From the trajectory that follows the observations no game was solved.
        usual = solve(game, initial, theta, gamma)
        return fit(initial_guess=usual) if int(usual.status) == Status.SOLVED else found


def scene_game_of(history: History) -> SceneGame:
    """Return the game of a history.

    Raises:
        ValueError: there is none, or it has another number of agents.
    """
    known = history.context.game
    if known is None:
        raise ValueError(
            "history.context.game: is None; scene-game predicts where the game is known, as in "
            "histories of an environment (`history_of`), not in recordings"
        )
    if len(known.game.players) != len(history.kinds):
        raise ValueError(
            f"history.context.game: has {len(known.game.players)} players; expected one for each "
            f"of the history's {len(history.kinds)} agents"
        )
    return known


def steps_between(history: History, game: Game) -> int:
    """Return how many steps of the game a step of the history has.

    Raises:
        ValueError: it is no whole number.
    """
    every = round(history.dt / game.dt)
    if every < 1 or abs(every * game.dt - history.dt) > MISSED_STEP:
        raise ValueError(
            f"history.dt: is {history.dt:g} s; expected a multiple of the game's step, "
            f"{game.dt:g} s"
        )
    return every


def replanned(game: Game, found: Estimate, now: int, steps: int) -> Float[np.ndarray, "P N 2"]:
    """Return positions (m) of agents that play the first stage of a new equilibrium at every step.

    Args:
        game: over their planning horizon.
        found: the fit; its own equilibrium from now on is where the first solve starts.
        now: row of its states from which the agents re-plan.
        steps: P, of the game.

    Returns:
        Positions after 1..P steps. Where a solve fails the last plan is continued, and the fit's
        equilibrium where the first one does.
    """
    fitted = found.solution
    plan: Solution | None = None
    guess: Any = [u[now : now + game.horizon] for u in fitted.controls]
    states = [np.asarray(x[now]) for x in fitted.states]
    path = []
    for _ in range(steps):
        solved = solve(
            game, inside_bounds(game, states), found.theta, found.gamma, initial_guess=guess
        )
        if int(solved.status) == Status.SOLVED:
            plan = solved
        elif plan is None:
            return np.stack([x[now + 1 : now + 1 + steps, :2] for x in fitted.states], axis=1)
        else:
            plan = shift(plan)
        states = [np.asarray(x[1]) for x in plan.states]
        path.append(np.stack([x[:2] for x in states]))
        guess = shift(plan)
    return np.stack(path)
