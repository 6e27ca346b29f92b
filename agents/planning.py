"""Receding-horizon planning that every ego shares: solve, keep the plan, fall back when it fails."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.policy import Decision
from foresight_env.envs.scene import Scene
from foresight_env.equilibrium import Solution, Status, shift, solve
from foresight_env.equilibrium.best_response import best_response_game, best_response_parameters
from foresight_env.games import Game
from foresight_env.games.types import Theta


class Plan(NamedTuple):
    """The last plan, to warm-start the next and to fall back on."""

    solution: Solution
    player: int
    """Which of the solved game's players the ego is."""


def inside_bounds(game: Game, states: Sequence[Float[np.ndarray, "_"]]) -> list[np.ndarray]:
    """States clipped into their players' bounds: estimates may lie just outside."""
    out = []
    for player, state in zip(game.players, states, strict=True):
        box = player.state_bounds
        out.append(state if box is None else np.clip(state, box.lower[0], box.upper[0]))
    return out


def brake(scene: Scene, state: Float[np.ndarray, "4"]) -> Float[np.ndarray, "2"]:
    """The control that brings a double integrator to rest as fast as its limits allow."""
    return -state[2:4] / scene.dt


def _within_limits(game: Game, player: int, control: np.ndarray) -> np.ndarray:
    box = game.players[player].control_bounds
    return control if box is None else np.clip(control, box.lower[0], box.upper[0])


def _decide(
    scene: Scene,
    ego: int,
    solution: Solution,
    place: int,
    previous: Plan | None,
    own_state: np.ndarray,
    predicted: dict[int, np.ndarray],
    gammas: dict[int, tuple[float, float]],
) -> tuple[Decision, Plan | None]:
    solved = int(solution.status) == Status.SOLVED
    if solved:
        plan: Plan | None = Plan(solution, place)
    else:
        plan = None if previous is None else previous._replace(solution=shift(previous.solution))
    if plan is None:
        action, path = brake(scene, own_state), None
    else:
        action = plan.solution.controls[plan.player][0]
        path = plan.solution.states[plan.player][1:, :2]
    action = _within_limits(scene.game, ego, np.asarray(action)).astype(np.float32)
    return Decision(action, path, predicted, gammas, not solved), plan


def plan_equilibrium(
    scene: Scene,
    ego: int,
    states: Sequence[Float[np.ndarray, "_"]],
    theta: Sequence[Theta],
    gamma: Float[np.ndarray, "N"],
    previous: Plan | None,
    gammas: dict[int, tuple[float, float]],
) -> tuple[Decision, Plan | None]:
    """Everybody plays the equilibrium of the scene's game; the ego takes its part of it."""
    game = scene.game
    bounded = inside_bounds(game, states)
    guess = None if previous is None else shift(previous.solution)
    if guess is not None and len(guess.states) != len(game.players):
        guess = None
    solution = solve(game, bounded, theta, gamma, guess=guess)
    if int(solution.status) != Status.SOLVED and guess is not None:
        solution = solve(game, bounded, theta, gamma)
    predicted = {}
    if int(solution.status) == Status.SOLVED:
        predicted = {j: s[1:, :2] for j, s in enumerate(solution.states) if j != ego}
    return _decide(scene, ego, solution, ego, previous, bounded[ego], predicted, gammas)


def plan_response(
    scene: Scene,
    ego: int,
    own_state: Float[np.ndarray, "_"],
    own_theta: Theta,
    own_gamma: float,
    predicted: dict[int, Float[np.ndarray, "T _"]],
    previous: Plan | None,
) -> tuple[Decision, Plan | None]:
    """The others follow `predicted` (joint states, T stages) whatever happens; the ego adapts."""
    game = scene.game
    alone = best_response_game(game, ego)
    state = np.asarray(own_state)
    box = game.players[ego].state_bounds
    if box is not None:
        state = np.clip(state, box.lower[0], box.upper[0])
    theta: dict[str, Any] = best_response_parameters(game, ego, own_theta, predicted)
    guess = None if previous is None else shift(previous.solution)
    solution = solve(alone, [state], [theta], [own_gamma], guess=guess)
    if int(solution.status) != Status.SOLVED and guess is not None:
        solution = solve(alone, [state], [theta], [own_gamma])
    paths = {j: s[:, :2] for j, s in predicted.items()}
    return _decide(scene, ego, solution, 0, previous, state, paths, {})
