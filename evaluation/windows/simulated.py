"""Windows of simulated episodes for predictors: what an ego would have seen, and what happened.

Everybody plays the game, the ego as well. Steps are as long as those of recorded windows, about
`STEP_SECONDS`, so that predictors meet them as they meet people.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from agents.egos.predict_then_plan import history_of
from evaluation.rollout.places import setting_of
from evaluation.studies.closed_loop import episode
from evaluation.windows.interaction import LEAST_OBSERVED, STEP_SECONDS, PredictionWindow

PREDICTED_STEPS = 6
"""2.4 s: episodes last 3 to 14."""
LEAST_PREDICTED = 3
BETWEEN = 2
"""Steps between an episode's moments."""


@lru_cache(maxsize=8)
def simulated_windows(place: str, seed: int) -> tuple[PredictionWindow, ...]:
    """The windows of one episode with the ego "oracle"; `frame` counts the environment's steps.

    The history is noisy, with the environment's own noise; the truth is not.
    """
    setting = setting_of(place)
    env = setting.make()
    steps = list(episode(env, "oracle", seed, setting.gammas))
    scene = env.scene
    every = max(1, round(STEP_SECONDS / scene.dt))
    sizes = (scene.players, len(steps[0].state[0]))
    seen = np.empty((len(steps), *sizes))
    # Whom an agent observes comes in this order: itself first.
    (ego,) = scene.controlled
    order = [ego, *(j for j in range(scene.players) if j != ego)]
    for k, step in enumerate(steps):
        seen[k, order] = step.observation[: sizes[0] * sizes[1]].reshape(sizes)
    places = np.stack([*(s.state[:, :2] for s in steps), steps[-1].info["state"][:, :2]])
    found = []
    first = (LEAST_OBSERVED - 1) * every
    for moment in range(first, len(places) - LEAST_PREDICTED * every, BETWEEN * every):
        rows = range(moment - first, moment + 1, every)
        plain = history_of(scene, tuple(seen[k] for k in rows))
        history = type(plain)(
            plain.states, plain.headings, plain.kinds, plain.extents, every * scene.dt
        )
        ahead = moment + every * np.arange(1, PREDICTED_STEPS + 1)
        there = ahead < len(places)
        truth = np.full((PREDICTED_STEPS, scene.players, 2), np.nan)
        truth[there] = places[ahead[there]]
        found.append(PredictionWindow(f"{place} {seed}", scene.names, moment, history, truth))
    return tuple(found)
