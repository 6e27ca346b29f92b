"""The update step of the Kalman filter."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def kalman_update(
    mean: Float[np.ndarray, "n"],
    covariance: Float[np.ndarray, "n n"],
    rates: Float[np.ndarray, "k n"],
    innovation: Float[np.ndarray, "k"],
    noise: Float[np.ndarray, "k k"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n"]]:
    """Return mean and covariance after an observation.

    Args:
        mean: of the state before it.
        covariance: of the state before it.
        rates: derivative of the observed values by the state.
        innovation: observed minus expected values.
        noise: covariance of the observation's noise.

    Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation"
    (2001), section 5.2.3.
    """
    spread = rates @ covariance @ rates.T + noise
    gain = np.linalg.solve(spread, rates @ covariance).T
    after = covariance - gain @ rates @ covariance
    return mean + gain @ innovation, 0.5 * (after + after.T)
