"""Constant velocity in several directions, the field's baseline for the best of 20 futures.

Schoeller, Aravantinos, Lay, Knoll, "What the constant velocity model can teach us about pedestrian
motion prediction", RA-L 2020, section IV: the last velocity turned by an angle of `N(0, 25 deg)`,
20 draws for each agent by itself. Here the angles are quantiles of that distribution, which lose no
accuracy to an unlucky draw and need no key; all agents turn by the same angle in a future.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from agents.interfaces.predictor import Forecast, History
from agents.predictors.kinematic import ConstantVelocityPredictor

FUTURES = 20
"""Draws of the paper: the quantiles at k / 20, k = 1 to 19, of which straight motion counts
twice."""


@dataclass(frozen=True)
class SampledVelocityPredictor:
    """Straight motion with the last observed velocity, turned by each of 19 angles."""

    name: str = "constant-velocity-sampled"
    angle_std: float = 25.0
    """Standard deviation of the angle, degrees."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; straight motion is its first and most likely future."""
        straight = ConstantVelocityPredictor().predict(history, steps).most_likely
        last = np.stack(
            [history.states[history.seen(i)[-1], i, :2] for i in range(len(history.kinds))]
        )
        angles = directions(np.deg2rad(self.angle_std))
        turns = np.stack(
            [
                np.stack([np.cos(angles), -np.sin(angles)], axis=1),
                np.stack([np.sin(angles), np.cos(angles)], axis=1),
            ],
            axis=1,
        )
        turned = last + np.einsum("mij,pnj->mpni", turns, straight - last)
        turned[0] = straight
        probabilities = np.full(len(angles), 1.0 / FUTURES)
        probabilities[0] *= 2.0
        return Forecast(turned, probabilities)


def directions(std: float) -> Float[np.ndarray, "_"]:
    """Quantiles of `N(0, std^2)` at k / `FUTURES`, rad; 0 first, then by their size."""
    levels = np.arange(1, FUTURES) / FUTURES
    angles = std * norm.ppf(levels)
    angles[FUTURES // 2 - 1] = 0.0
    return np.asarray(angles[np.argsort(np.abs(angles), kind="stable")])
