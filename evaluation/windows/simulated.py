"""Windows of simulated episodes for predictors: an ego's observations and the ground truth.

All agents play the game, the ego as well. Steps are as long as those of recorded windows, about
`STEP_SECONDS`, so that predictors meet them as they meet people.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from agents.egos.predict_then_plan import history_of
from evaluation.rollout.episode import observed_states, run_episode
from evaluation.rollout.places import setting_of
from evaluation.rollout.setting import RunSetting
from evaluation.windows.interaction import LEAST_OBSERVED, STEP_SECONDS, PredictionWindow

PREDICTED_STEPS = 6
"""2.4 s: episodes last 3 to 14."""
LEAST_PREDICTED = 3
BETWEEN = 2
"""Steps between an episode's moments."""


@lru_cache(maxsize=8)
def simulated_windows(place: str, seed: int) -> tuple[PredictionWindow, ...]:
    """The windows of one episode at a place, `windows_of` its setting."""
    return windows_of(setting_of(place), seed, place)


def windows_of(setting: RunSetting, seed: int, name: str) -> tuple[PredictionWindow, ...]:
    """Return the windows of one episode with the ego "oracle"; `frame` counts steps.

    The history is noisy, with the environment's own noise; the truth is not. Its context has the
    place's routes and game.

    Args:
        setting: of the episode.
        seed: of the episode.
        name: of the place, for the windows.
    """
    setting = replace(setting, safety_filter=False)
    episode = run_episode(setting, "oracle", seed)
    scene, places = episode.scene, episode.states[..., :2]
    every = max(1, round(STEP_SECONDS / scene.dt))
    seen = observed_states(
        np.stack([step.observation for step in episode.steps]), scene.controlled[0], scene.players
    )
    found = []
    first = (LEAST_OBSERVED - 1) * every
    for moment in range(first, len(places) - LEAST_PREDICTED * every, BETWEEN * every):
        rows = range(moment - first, moment + 1, every)
        plain = history_of(scene, tuple(seen[k] for k in rows))
        history = replace(plain, dt=every * scene.dt)
        ahead = moment + every * np.arange(1, PREDICTED_STEPS + 1)
        there = ahead < len(places)
        truth = np.full((PREDICTED_STEPS, scene.players, 2), np.nan)
        truth[there] = places[ahead[there]]
        found.append(PredictionWindow(f"{name} {seed}", scene.names, moment, history, truth))
    return tuple(found)
