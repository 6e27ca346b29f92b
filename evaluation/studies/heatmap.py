"""The inverse objective over both discount factors, goals at the truth (paper, figure 4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evaluation.studies.estimation import joint
from foresight_env.equilibrium import Solution, Status, solve, solve_many
from foresight_env.scenarios.crosswalk import HEATMAP, Proximity, crosswalk_game


class Heatmap(NamedTuple):
    """Unscaled objective of noise-free observations; NaN where a game was not solved."""

    gammas: Float[np.ndarray, "G"]
    full: Float[np.ndarray, "G G"]
    """Rows: discount factor of player 0; columns: of player 1."""
    positions: Float[np.ndarray, "G G"]
    unsolved: int


def heatmap(size: int = 41, proximity: Proximity = "soft", largest: float = 1.2) -> Heatmap:
    """Evaluate the objective on a `size` x `size` grid over (0, `largest`]."""
    if size < 2:
        raise ValueError(f"size: is {size}; expected at least 2")
    game, setting = crosswalk_game(2, proximity=proximity), HEATMAP
    true = joint(solve(game, setting.initial_state, setting.theta, setting.gamma, throw=True))
    gammas = np.linspace(0.02, largest, size)

    full, places = np.full((size, size), np.nan), np.full((size, size), np.nan)
    found: Solution | None = None
    for k, first in enumerate(gammas):
        pairs = np.stack([np.full(size, first), gammas], axis=1)
        states = np.broadcast_to(setting.initial_state, (size, *setting.initial_state.shape))
        # From the row before: a third of the time of cold starts.
        found = solve_many(game, states, setting.theta, pairs, initial_guess=found)
        squared = (np.concatenate(found.states, axis=2) - true) ** 2
        solved = found.status == Status.SOLVED
        full[k] = np.where(solved, squared.sum(axis=(1, 2)), np.nan)
        places[k] = np.where(solved, squared[:, :, [0, 1, 4, 5]].sum(axis=(1, 2)), np.nan)
    return Heatmap(gammas, full, places, int(np.isnan(full).sum()))
