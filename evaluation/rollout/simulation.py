"""Simulation of an episode under a given sequence of the ego's actions.

The others are what the setting says they are: they see the ego move and react. All of it is
deterministic, so the same actions lead to the same episode, and an ego's recorded actions repeat
its episode.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evaluation.rollout.endings import HARM, ending
from evaluation.rollout.episode import begin_episode


class Score(NamedTuple):
    """How good an episode was for the ego; the smaller, the better, as tuples are compared."""

    harmed: bool
    """Whether it ended in a collision or off the road: worse than any cost."""
    cost: float
    """Undiscounted cost of the ego, integrated over time."""


class Simulated(NamedTuple):
    """An episode under given actions, to its end or to where it could no longer be good enough."""

    score: Score
    finished: bool
    """Whether it was simulated to its end; if not, `score.cost` is that of the part simulated."""
    actions: Float[np.ndarray, "K m"]
    """Of the ego, as applied."""
    states: Float[np.ndarray, "stages N n"]
    """Of all agents, the last one included."""
    info: dict[str, Any]
    """The ego's information at the end."""

    @property
    def ended(self) -> str:
        """How the episode ended (`rollout.endings`)."""
        return ending(self.info)


def simulate(
    env: Any,
    seed: int,
    gammas: tuple[float, float],
    actions: Float[np.ndarray, "K m"],
    limit: float = np.inf,
) -> Simulated:
    """Simulate an episode in which the ego takes these actions.

    Args:
        env: parallel environment whose one controlled agent is the ego.
        seed: of the episode.
        gammas: range of the others' discount factors, as in `rollout.episode.begin_episode`.
        actions: of the ego, one row per step; clipped to the action space, zero after the last row.
        limit: cost at which the simulation stops; costs of steps are never negative.

    Returns:
        The episode, to its end or to where its cost reached `limit`.
    """
    _, infos = begin_episode(env, seed, gammas)
    agent, space = env.agents[0], env.action_space(env.agents[0])
    zero = np.zeros(space.shape, dtype=np.float32)
    applied: list[np.ndarray] = []
    states, cost = [infos[agent]["state"]], 0.0
    while env.agents:
        wanted = actions[len(applied)] if len(applied) < len(actions) else zero
        applied.append(np.clip(wanted, space.low, space.high).astype(np.float32))
        _, rewards, _, _, infos = env.step({agent: applied[-1]})
        states.append(infos[agent]["state"])
        cost -= float(rewards[agent])
        if cost * env.scene.dt >= limit:
            break
    info = infos[agent]
    return Simulated(
        Score(ending(info) in HARM, cost * env.scene.dt),
        not env.agents,
        np.stack(applied),
        np.stack(states),
        info,
    )
