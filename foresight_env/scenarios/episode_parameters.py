"""One episode's hidden truth, in whatever scenario."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float


class EpisodeParameters(NamedTuple):
    """Where everybody begins, what everybody wants and how far ahead everybody looks."""

    initial_state: Float[np.ndarray, "N 4"]
    theta: tuple[dict[str, Any], ...]
    """Cost parameters per player, as the scenario's `player_theta` makes them."""
    gamma: Float[np.ndarray, "N"]
