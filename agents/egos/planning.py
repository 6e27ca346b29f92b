"""Receding-horizon planner of all egos: solve, and keep the plan as a fallback."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.interfaces.policy import Decision
from foresight_env.envs.core.motion import braking
from foresight_env.envs.core.scene import Scene
from foresight_env.equilibrium import Budget, Solution, Status, shift, solve
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)
from foresight_env.games import Game, Vehicle, inside_bounds
from foresight_env.games.motion import planar_velocity
from foresight_env.games.types import Theta

Guess = Solution | Sequence[Float[np.ndarray, "T _"]] | None
"""Start of a plan: a solution, all players' controls, or cold."""


LOOK_AHEAD = 2.0
"""Least time that an ego plans its own motion for, s. With the driving scenes' horizon of 1.1 s a
car begins to brake too late, whatever it predicts."""
FULL_GAMMA = 1.0
"""Discount factor of a plan that is longer than the game: costs count as episodes are scored."""


def needs_longer_plan(scene: Scene, ego: int, state: Float[np.ndarray, "_"]) -> bool:
    """Whether an ego plans `LOOK_AHEAD` instead of the game's shorter horizon.

    It does unless it is a car that cannot stop within that time: at the merge, at 15 m/s, longer
    plans cost more (docs/development/design.md).
    """
    if scene.game.horizon >= round(LOOK_AHEAD / scene.dt):
        return False
    player = scene.game.players[ego]
    if not isinstance(player.dynamics, Vehicle) or player.control_bounds is None:
        return True
    return bool(state[2] <= -player.control_bounds.lower[0][0] * LOOK_AHEAD)


def looking_ahead(scene: Scene) -> Scene:
    """The scene with a game over the stages of an ego's own plan, `LOOK_AHEAD` at least."""
    horizon = max(scene.game.horizon, round(LOOK_AHEAD / scene.dt))
    return replace(scene, game=replace(scene.game, horizon=horizon))


class Plan(NamedTuple):
    """The last plan, to warm-start the next and to fall back on."""

    solution: Solution
    player: int
    """The ego's index among the solved game's players."""


def within_limits(game: Game, player: int, control: np.ndarray) -> np.ndarray:
    """The nearest control that the player may apply."""
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
        action: np.ndarray = braking(scene.game, ego, own_state)
        path: np.ndarray | None = None
    else:
        action = np.asarray(plan.solution.controls[plan.player][0])
        path = np.asarray(plan.solution.states[plan.player][1:, :2])
    action = within_limits(scene.game, ego, action).astype(np.float32)
    return Decision(action, path, predicted, gammas, not solved), plan


def plan_equilibrium(
    scene: Scene,
    ego: int,
    states: Sequence[Float[np.ndarray, "_"]],
    theta: Sequence[Theta],
    gamma: Float[np.ndarray, "N"],
    previous: Plan | None,
    gammas: dict[int, tuple[float, float]],
    guesses: Sequence[Guess] = (),
    *,
    budget: Budget = Budget.offline(),
) -> tuple[Decision, Plan | None]:
    """Plan an equilibrium of the scene's game; the ego takes its part of it.

    Solves from the previous plan and then from every other guess (None is a cold start). A limited
    `budget` ends the search at the first solution; otherwise the first solve of more than
    `ALTERNATIVE_STEPS` Newton steps does. All solves but one from the last guess, where no other
    led to a plan, are trials. Where several equilibria are found, the one is taken that asks the
    others for the least change of their motion: agents that assume different ones collide or wait
    for the whole episode.
    """
    game = scene.game
    bounded = inside_bounds(game, states)
    starts: list[Guess] = list(guesses)
    if previous is not None and len(previous.solution.states) == len(game.players):
        starts.insert(0, shift(previous.solution))
    best, least = None, np.inf
    limited = budget != Budget.offline()
    trials = budget if limited else Budget.trial()
    starts = starts or [None]
    for number, start in enumerate(starts, 1):
        solved = best is not None and int(best.status) == Status.SOLVED
        trial = solved or number < len(starts)
        solution = solve(
            game,
            bounded,
            theta,
            gamma,
            initial_guess=start,
            budget=trials if trial else Budget.offline(),
        )
        if int(solution.status) != Status.SOLVED:
            best = solution if best is None else best
            continue
        change = _change_of_others(scene, ego, bounded, solution)
        if change < least - SAME_CHANGE:
            best, least = solution, change
        if limited or int(solution.iterations) > ALTERNATIVE_STEPS:
            break
    assert best is not None
    predicted: dict[int, np.ndarray] = {}
    if int(best.status) == Status.SOLVED:
        predicted = {j: np.asarray(s[1:, :2]) for j, s in enumerate(best.states) if j != ego}
    return _decide(scene, ego, best, ego, previous, bounded[ego], predicted, gammas)


ALTERNATIVE_STEPS = 15
"""Newton steps of a solve after which no further initial guess is tried at this decision: there is
the next one. Of 1725 left turns' and roundabouts' decisions another equilibrium was preferred in
115; in 101 of these the first solve was quicker than this."""
INERTIA_STEPS = 8
"""Steps over which equilibria are compared with straight motion of all."""
SAME_CHANGE = 1e-3
"""Mean squared distance (m^2) below which two equilibria count as the same: the first is kept."""


def _change_of_others(
    scene: Scene, ego: int, states: Sequence[np.ndarray], solution: Solution
) -> float:
    """Mean squared distance (m^2) of the others' next steps from straight motion."""
    total = 0.0
    times = scene.dt * np.arange(1, INERTIA_STEPS + 1)[:, None]
    for j, state in enumerate(states):
        if j != ego:
            velocity = planar_velocity(scene.game.players[j].dynamics, state)
            straight = state[:2] + times * velocity
            path = solution.states[j][1 : INERTIA_STEPS + 1, :2]
            total += float(np.mean(np.sum((path - straight[: len(path)]) ** 2, axis=1)))
    return total


def plan_response(
    scene: Scene,
    ego: int,
    own_state: Float[np.ndarray, "_"],
    own_theta: Theta,
    own_gamma: float,
    predicted: dict[int, Float[np.ndarray, "T _"]],
    previous: Plan | None,
) -> tuple[Decision, Plan | None]:
    """Plan the ego's best response to others that follow `predicted` (joint states, T stages)."""
    game = scene.game
    alone = best_response_game(game, ego)
    state = np.asarray(own_state)
    box = game.players[ego].state_bounds
    if box is not None:
        state = np.clip(state, box.lower[0], box.upper[0])
    theta: dict[str, Any] = best_response_parameters(game, ego, own_theta, predicted)
    fits = previous is not None and len(previous.solution.point.x) == game.horizon
    initial_guess = shift(previous.solution) if previous is not None and fits else None
    solution = solve(alone, [state], [theta], [own_gamma], initial_guess=initial_guess)
    paths = {j: s[:, :2] for j, s in predicted.items()}
    return _decide(scene, ego, solution, 0, previous, state, paths, {})
