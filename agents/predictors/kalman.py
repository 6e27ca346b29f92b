"""The Kalman filter as a predictor: nearly constant velocity, with white acceleration.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001),
section 6.2.2, continuous white noise acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse.kalman import kalman_update


@dataclass(frozen=True)
class KalmanPredictor:
    """Filters each agent's positions and velocities, and predicts with the filter."""

    name: str = "kalman"
    noise_std: float = 0.02
    """Standard deviation of what is observed, m and m/s."""
    walking: float = 0.06
    """Power spectral density of people's acceleration per axis, m^2/s^3: velocities change by its
    root times that of the time that passes. All three of best likelihood on the development
    recordings of `evaluation.windows.interaction`, of a few values tried."""
    driving: float = 0.5
    """And of vehicles'."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast, with covariances."""
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
        growth = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        driven = is_vehicle(history.kinds[agent])
        process = (self.driving if driven else self.walking) * np.kron(growth, np.eye(2))
        noise = self.noise_std**2 * np.eye(4)
        rows = history.seen(agent)
        mean, covariance = history.states[rows[0], agent], noise
        places, spread = [], []
        for k in range(rows[0] + 1, len(history.states) + steps):
            mean = motion @ mean
            covariance = motion @ covariance @ motion.T + process
            if k in rows:
                seen = history.states[k, agent] - mean
                mean, covariance = kalman_update(mean, covariance, np.eye(4), seen, noise)
            elif k >= len(history.states):
                places.append(mean[:2])
                spread.append(0.5 * (covariance + covariance.T)[:2, :2])
        return np.stack(places), np.stack(spread)
