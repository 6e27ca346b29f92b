"""highway-env's axes, whose y points down, and ours, whose y points up."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def flipped_places(places: Float[np.ndarray, "*K 2"]) -> Float[np.ndarray, "*K 2"]:
    """Positions in the other axes, either way."""
    return np.asarray(places * np.array([1.0, -1.0]))


def flipped_states(states: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 4"]:
    """States `[px, py, v, psi]` in the other axes, either way."""
    return np.asarray(states * np.array([1.0, -1.0, 1.0, -1.0]))


def flipped_controls(controls: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
    """Controls `[a, steering]` in the other axes, either way."""
    return np.asarray(controls * np.array([1.0, -1.0]))
