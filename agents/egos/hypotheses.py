"""Hypotheses of an ego about the others, their weights, and its plan for all of them.

The hypotheses are the equilibrium of the game that the ego plays, and that the others do not react:
they keep their speed, along their route or straight on, as agents that play no game may. Each is
weighted by its prior and by how well it predicted the others' latest positions; the plan has the
least expected cost. It is for games of a short horizon: it looks farther ahead (`LOOK_AHEAD`), and
counts all costs fully.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.car_paths import along, path_ahead
from agents.egos.expected_response import expected_response_game, expected_response_parameters
from agents.egos.motion import extrapolate
from agents.egos.planning import FULL_GAMMA, looking_ahead, within_limits
from agents.interfaces.policy import Decision, Hypothesis
from foresight_env.envs.core.scene import Scene
from foresight_env.equilibrium import Budget, Solution, SolverOptions, Status, shift, solve
from foresight_env.equilibrium.settings import CentralPath
from foresight_env.games import Dynamics, Game, inside_bounds
from foresight_env.games.types import Theta

EQUILIBRIUM, NO_REACTION = "equilibrium", "no reaction"
"""Names of the hypotheses, in their order."""
PRECISION = SolverOptions(
    tolerance=1e-3, barrier=1e-3, warm_barrier=0.1, path=CentralPath(end_width=1.0)
)
"""Of a plan, of which one control is applied: fewer Newton steps, and fewer failures, than to the
solver's usual accuracy."""
BUDGET = Budget(phases=1, newton_steps=40)
"""Of each of at most two solves: the last plan, continued, is better than one that comes late."""

Paths = Mapping[int, Float[np.ndarray, "T _"]]
"""Others' states after stages 1..T by player."""


class Others(NamedTuple):
    """States and parameters of all players, as an ego knows them."""

    states: Sequence[Float[np.ndarray, "4"]]
    """Present states, from which all hypotheses go on."""
    theta: Sequence[Theta]
    """Estimated parameters; those of cars with a route have its `path`."""
    observed: Sequence[Float[np.ndarray, "4"]]
    """Present states by the latest observations alone, which earlier predictions are compared
    with."""


class HypothesesMemory(NamedTuple):
    """The last plan, and what the hypotheses predicted and explained so far."""

    solution: Solution | None = None
    predicted: tuple[Float[np.ndarray, "count N 2"], ...] = ()
    """Positions `lag` steps ahead by the latest decisions' hypotheses, the newest last, m; NaN of
    the ego, and where there was no equilibrium."""
    score: Float[np.ndarray, "count"] = np.zeros(2)
    """Logarithm of the hypotheses' weights, up to a constant, without prior and least weight."""


@dataclass(frozen=True)
class Hypotheses:
    """Setting of weights and plan; chosen on development seeds."""

    prior: float = 0.5
    """Of the equilibrium."""
    least: float = 0.33
    """Least weight of a hypothesis: others that have shown no reaction so far may show one later,
    and the other way round."""
    lag: int = 5
    """Steps after which a prediction is compared with what was observed."""
    deviation: float = 0.15
    """Standard deviation of these predictions' errors if the hypothesis is true, m."""
    forgetting: float = 0.8
    """Factor of all earlier evidence per step."""

    def plan(
        self,
        scene: Scene,
        ego: int,
        others: Others,
        equilibrium: Solution | None,
        decision: Decision,
        memory: HypothesesMemory,
    ) -> tuple[Decision, HypothesesMemory]:
        """Plan for all hypotheses; without any plan, the given decision is returned.

        Args:
            scene: with the game and the ego's own parameters.
            ego: the player.
            others: their states and parameters, and the ego's own.
            equilibrium: of the scene's game; None where it was not solved.
            decision: what the equilibrium has the ego do.
            memory: of the last plan.
        """
        game, states = looking_ahead(scene).game, others.states
        unmoved = {
            j: onward(player.dynamics, others.theta[j], states[j], game.horizon, scene.dt)
            for j, player in enumerate(game.players)
            if j != ego
        }
        played: Paths = unmoved
        if equilibrium is not None:
            played = continued(scene, ego, equilibrium, others.theta, game)
        hypotheses = played, unmoved
        memory = self._compared(memory, ego, others.observed)
        ahead = np.full((len(hypotheses), len(states), 2), np.nan)
        if equilibrium is not None:
            for k, paths in enumerate(hypotheses):
                for j, path in paths.items():
                    ahead[k, j] = path[min(self.lag, len(path)) - 1, :2]
        memory = memory._replace(predicted=(*memory.predicted, ahead)[-self.lag :])
        weights = self.weights(memory.score)
        solution, solved = _solved(
            expected_response_game(game, ego, len(hypotheses)),
            inside_bounds(scene.game, states)[ego],
            expected_response_parameters(game, ego, scene.own(ego).theta, hypotheses, weights),
            memory.solution,
        )
        if solution is None:
            return decision, memory._replace(solution=None)
        found = tuple(
            Hypothesis(name, float(weight), {j: path[:, :2] for j, path in paths.items()})
            for name, weight, paths in zip(
                (EQUILIBRIUM, NO_REACTION), weights, hypotheses, strict=True
            )
        )
        control = np.asarray(solution.controls[0][0])
        decision = replace(
            decision,
            action=within_limits(scene.game, ego, control).astype(np.float32),
            planned=np.asarray(solution.states[0])[1:, :2],
            predicted=found[int(np.argmax(weights))].predicted,
            hypotheses=found,
            plan_fallback=not solved,
        )
        return decision, memory._replace(solution=solution)

    def _compared(
        self, memory: HypothesesMemory, ego: int, observed: Sequence[Float[np.ndarray, "4"]]
    ) -> HypothesesMemory:
        """The memory with the evidence of the others' present positions."""
        if len(memory.predicted) < self.lag:
            return memory
        places = np.stack([state[:2] for state in observed])
        error = np.sum((memory.predicted[-self.lag] - places) ** 2, axis=2)
        error = np.delete(error, ego, axis=1).sum(axis=1)
        if not np.isfinite(error).all():
            return memory
        # Half the squared error in deviations, twice: errors of `lag` successive predictions are
        # correlated, and their sum counts as that of two.
        likelihood = -error / self.deviation**2 / self.lag
        return memory._replace(score=self.forgetting * memory.score + likelihood)

    def weights(self, score: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """Weights of the hypotheses from the logarithm of what they explain."""
        total = score + np.log([self.prior, 1.0 - self.prior])
        likely = np.exp(total - total.max())
        rest = 1.0 - len(likely) * self.least
        found: Float[np.ndarray, "2"] = self.least + rest * likely / likely.sum()
        return found


def _solved(
    game: Game,
    state: Float[np.ndarray, "4"],
    theta: Mapping[str, Any],
    previous: Solution | None,
) -> tuple[Solution | None, bool]:
    """Plan from the shifted last one, else from a cold start, and whether it is solved for.

    If it is not, the last plan continued; None without one.
    """
    shifted = None if previous is None else shift(previous)
    for start in (shifted, None)[shifted is None :]:
        found = solve(
            game,
            [state],
            [theta],
            [FULL_GAMMA],
            initial_guess=start,
            options=PRECISION,
            budget=BUDGET,
        )
        if int(found.status) == Status.SOLVED:
            return found, True
    return shifted, False


def continued(
    scene: Scene, ego: int, solution: Solution, theta: Sequence[Theta], game: Game
) -> Paths:
    """The others' states in an equilibrium, and at their last speed after its end."""
    found = {}
    for j, player in enumerate(game.players):
        if j != ego:
            states = np.asarray(solution.states[j])[1 : game.horizon + 1]
            rest = game.horizon - len(states)
            if rest > 0:
                later = onward(player.dynamics, theta[j], states[-1], rest, scene.dt)
                states = np.concatenate([states, later])
            found[j] = states
    return found


def onward(
    dynamics: Dynamics, theta: Theta, state: Float[np.ndarray, "4"], steps: int, dt: float
) -> Float[np.ndarray, "T 4"]:
    """States after 1..steps steps at the present speed: along a car's route, or straight on."""
    if "path" not in theta:
        return extrapolate(dynamics, state, steps, dt)
    speed = max(float(state[2]), 0.0)
    route = path_ahead(state[[0, 1, 3]], np.zeros((0, 2)), np.asarray(theta["path"])[:, :3])
    poses = along(route, speed * dt * np.arange(1, steps + 1)[None])[0]
    found: Float[np.ndarray, "T 4"] = np.insert(poses, 2, speed, axis=1)
    return found
