"""The clairvoyant: a best response to the others' true behaviour, by simulation, offline.

An upper bound of what the compared egos achieve in an episode, and no competitor. The search is a
heuristic: a true best response may be better still. Its candidates are whole sequences of actions.
The first are those of the egos that it is compared with; further ones are searched: the ego's
optimal control over the whole episode with the others on the paths that they took in the best
simulation so far, with random weights of its costs, since others may react to a firmer or a more
cautious ego. Every candidate is simulated among the others as they are (`rollout.simulation`), and
the best is kept. So its score is never worse than that of any ego whose actions it was given, and
its cost is undiscounted, as episodes are scored.

It gains more than the value of knowing discount factors: it has exact states and knows how others
react. The ego `know-gamma` measures the value of discount factors alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from evaluation.rollout.simulation import Simulated, simulate
from foresight_env.equilibrium import Budget, Status, solve
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)

CLAIRVOYANT = "clairvoyant"
"""Its name in tables."""
EAGERNESS = ("goal_weight", "speed_weight")
"""Entries of `theta`, of which each scenario has one, that weigh an ego's progress."""

DIFFERENT = 0.5
"""Distance (m), at some time, from which on two paths of the ego count as different."""


@dataclass(frozen=True)
class Clairvoyant:
    """Search of the best response."""

    candidates: int = 16
    """Searched ones, in addition to the given: half of them around the best factors so far. Twice
    as many lower the cost by 0.7 % (docs/development/design.md)."""
    spread: float = 1.0
    """Standard deviation of the logarithms of both factors, of the ego's collision weight and of
    its weight of progress; half as large around the best."""

    def respond(
        self,
        env: Any,
        seed: int,
        gammas: tuple[float, float],
        given: Sequence[Float[np.ndarray, "_ m"]],
    ) -> Simulated:
        """Return the best simulated episode.

        Args:
            env: parallel environment whose one controlled agent is the ego.
            seed: of the episode.
            gammas: range of the others' discount factors, as in `rollout.episode.begin_episode`.
            given: sequences of actions, at least one, that the search begins from.

        Raises:
            ValueError: no sequence is given.
        """
        if not given:
            raise ValueError("given: is empty; expected at least one sequence of actions")
        starts = [simulate(env, seed, gammas, actions) for actions in given]
        best = min(starts, key=lambda found: found.score)
        random = np.random.default_rng([seed, 2])
        # First the plain response to each start that passes others in another way.
        ways = _different(sorted(starts, key=lambda found: found.score), env.scene.controlled[0])
        centre = np.zeros(2)
        for k in range(self.candidates):
            if k < len(ways):
                start, factors = ways[k], np.zeros(2)
            else:
                late = 2 * k >= self.candidates
                spread = self.spread * (0.5 if late else 1.0)
                start, factors = best, (centre if late else 0.0) + random.normal(0.0, spread, 2)
            actions = _planned(env, start, np.exp(factors))
            if actions is None:
                continue
            limit = np.inf if best.score.harmed else best.score.cost
            found = simulate(env, seed, gammas, actions, limit)
            if found.finished and found.score < best.score:
                best, centre = found, factors
        return best


def _different(starts: Sequence[Simulated], ego: int) -> list[Simulated]:
    """Those of which the ego's path is somewhere far from that of all before it."""
    chosen: list[Simulated] = []
    for start in starts:
        paths = [(start.states[:, ego, :2], other.states[:, ego, :2]) for other in chosen]
        if all(
            np.linalg.norm(a[: len(b)] - b[: len(a)], axis=1).max() > DIFFERENT for a, b in paths
        ):
            chosen.append(start)
    return chosen


def _planned(
    env: Any, start: Simulated, factors: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "K m"] | None:
    """The ego's optimal actions with the others on the paths of `start`; None: none found.

    `factors`: of the ego's collision weight and of its weight of progress.
    """
    scene = env.scene
    ego, horizon = scene.controlled[0], scene.max_steps
    game = env.world.game(horizon)
    own = dict(scene.own(ego).theta)
    for names, factor in zip((("collision_weight",), EAGERNESS), factors, strict=True):
        own |= {name: own[name] * factor for name in names if name in own}
    # Beyond its end the episode's last states stand for the others' later ones.
    later = np.minimum(np.arange(1, horizon + 1), len(start.states) - 1)
    others = {j: start.states[later, j] for j in range(scene.players) if j != ego}
    guess = np.zeros((horizon, start.actions.shape[1]))
    guess[: len(start.actions)] = start.actions[:horizon]
    found = solve(
        best_response_game(game, ego),
        [start.states[0, ego]],
        [best_response_parameters(game, ego, own, others)],
        [1.0],
        initial_guess=[guess],
        budget=Budget.trial(),
    )
    return np.asarray(found.controls[0]) if int(found.status) == Status.SOLVED else None
