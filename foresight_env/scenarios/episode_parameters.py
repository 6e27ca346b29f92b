"""Parameters of one episode, in any scenario."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float


class EpisodeParameters(NamedTuple):
    """Initial states, cost parameters and discount factors of all agents."""

    initial_state: Float[np.ndarray, "N 4"]
    theta: tuple[dict[str, Any], ...]
    """Cost parameters per player, as the scenario's `player_theta` makes them."""
    gamma: Float[np.ndarray, "N"]
