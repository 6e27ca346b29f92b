"""Motion along a circle, the path of an agent that keeps its speed and its turn rate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def arc(
    velocity: Float[np.ndarray, "2"], turn: float, seconds: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K 2"]:
    """Displacements (m) after `seconds` on a circle that begins with `velocity` (m/s).

    `turn`: rad/s, positive to the left. The chord is the velocity turned by half the angle, times
    `seconds * sinc(angle / 2)`.
    """
    half = 0.5 * turn * seconds
    chord = seconds * np.sinc(half / np.pi)
    along, across = chord * np.cos(half), chord * np.sin(half)
    left = np.array([-velocity[1], velocity[0]])
    return np.asarray(along[:, None] * velocity + across[:, None] * left)
