"""Input of networks at the crosswalk: the last few observations, relative to the ego."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32

WINDOW = 4
"""Observations: one alone is too noisy."""
SIZE = 10
"""Of an observation of two: two states and the own goal."""


def crosswalk_window(observations: Float[np.ndarray, "*B K 10"]) -> Float32[np.ndarray, "*B 4 10"]:
    """The last observations, positions relative to the ego's observed one (m).

    Of fewer than `WINDOW` the first is repeated.
    """
    rows = np.asarray(observations, dtype=float)[..., -WINDOW:, :]
    missing = WINDOW - rows.shape[-2]
    rows = np.concatenate([np.repeat(rows[..., :1, :], missing, axis=-2), rows], axis=-2)
    origin = np.zeros((*rows.shape[:-2], 1, SIZE))
    for place in (0, 4, 8):
        origin[..., 0, place : place + 2] = rows[..., -1, :2]
    return np.asarray(rows - origin, np.float32)
