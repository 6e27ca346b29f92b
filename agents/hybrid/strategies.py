"""Polynomials of time that strategies are combined of."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from agents.hybrid.smooth_game import Basis
from agents.learned.features import STEP

DEGREE = 4
"""Highest power of time: changes of velocity, of acceleration and of its two derivatives."""
STEPS = 12
"""Steps of `STEP` seconds that a game covers: 4.8 s, the horizon of the ETH/UCY protocol."""
HORIZON = STEPS * STEP
"""s."""


def strategy_basis(times: Float[np.ndarray, "T"]) -> Basis:
    """Return combinations of the powers 1 to `DEGREE` of time, orthonormal at the game's steps.

    So coefficients of a strategy are root mean squares over the steps, m. After `HORIZON` the
    functions go on in straight lines.

    Args:
        times: s, not negative.
    """
    mixed, scale = _orthonormal()
    part = np.minimum(times, HORIZON)[:, None] / HORIZON
    beyond = np.maximum(times - HORIZON, 0.0)[:, None] / HORIZON
    numbers = np.arange(1, DEGREE + 1)
    slope = numbers * part ** (numbers - 1)
    bent = numbers * (numbers - 1) * part ** np.maximum(numbers - 2, 0) / HORIZON**2
    bent = np.where(beyond > 0.0, 0.0, bent)

    def combined(powers: Float[np.ndarray, "T B"]) -> Float[np.ndarray, "T B"]:
        return np.asarray((powers @ mixed * scale).astype(np.float32))

    value = combined(part**numbers + beyond * slope)
    return Basis(times.astype(np.float32), value, combined(bent))


def _orthonormal() -> tuple[Float[np.ndarray, "B B"], Float[np.ndarray, "B"]]:
    """Matrix and factors from powers of time to the basis."""
    times = np.arange(1, STEPS + 1) / STEPS
    orthonormal, upper = np.linalg.qr(times[:, None] ** np.arange(1, DEGREE + 1))
    return np.linalg.inv(upper), np.sqrt(STEPS) * np.sign(orthonormal[-1])


GAME_BASIS = strategy_basis(STEP * np.arange(1, STEPS + 1))
"""At the steps of a game."""
