"""The Kalman filter as a predictor: everybody keeps its velocity, with white acceleration.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001),
section 6.3.2, piecewise constant white acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.predictor import Forecast, History


@dataclass(frozen=True)
class KalmanPredictor:
    """Filters each agent's positions and velocities, and lets the filter run on."""

    name: str = "kalman"
    noise_std: float = 0.05
    """Standard deviation of what is observed, m and m/s."""
    acceleration_std: float = 0.8
    """Of the acceleration in a step, per axis, m/s^2. Of 0.2 to 1.6 the one with the best
    likelihood on the development recordings (`evaluation.prediction_window`)."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Where everybody will be, with covariances."""
        found = [self._one(history, agent, steps) for agent in range(len(history.kinds))]
        places = np.stack([mean for mean, _ in found], axis=1)
        spread = np.stack([covariance for _, covariance in found], axis=1)
        return Forecast(places[None], np.ones(1), spread[None])

    def _one(
        self, history: History, agent: int, steps: int
    ) -> tuple[Float[np.ndarray, "P 2"], Float[np.ndarray, "P 2 2"]]:
        dt = history.dt
        motion = np.eye(4)
        motion[:2, 2:] = dt * np.eye(2)
        gain = np.vstack([0.5 * dt**2 * np.eye(2), dt * np.eye(2)])
        process = self.acceleration_std**2 * gain @ gain.T
        noise = self.noise_std**2 * np.eye(4)
        rows = history.seen(agent)
        mean, covariance = history.states[rows[0], agent], noise
        places, spread = [], []
        for k in range(rows[0] + 1, len(history.states) + steps):
            mean = motion @ mean
            covariance = motion @ covariance @ motion.T + process
            if k in rows:
                weight = np.linalg.solve(covariance + noise, covariance).T
                mean = mean + weight @ (history.states[k, agent] - mean)
                covariance = covariance - weight @ covariance
            elif k >= len(history.states):
                places.append(mean[:2])
                spread.append(0.5 * (covariance + covariance.T)[:2, :2])
        return np.stack(places), np.stack(spread)
