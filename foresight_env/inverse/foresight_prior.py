"""Prior of a discount factor that prefers no scale: log-uniform in the effective horizon.

A discount factor that multiplies weights by `r` per stage looks about `1 / (1 - r)` stages ahead.
Whether that is one stage or a hundred is unknown, so its logarithm has a uniform prior,
from one stage (myopic) to `LONGEST` times the game, beyond which it counts as infinite. A uniform
prior of gamma itself would put nine tenths of its mass on fewer than ten stages.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from foresight_env.games.discounting import Discounting

LONGEST = 4.0
"""Effective horizon, in horizons of the game, that counts as infinite: over the whole game weights
then fall by less than a quarter. A definition of the prior, whose intervals `benchmarks.intervals`
measures."""
POINTS = 4001
"""Of the table between gamma and its rank: a numerical resolution, finest at the top."""


@dataclass(frozen=True, eq=False)
class ForesightPrior:
    """Ranks in [0, 1] of discount factors under the prior, and back."""

    gamma: Float[np.ndarray, "M"]
    """Rising discount factors."""
    rank: Float[np.ndarray, "M"]
    """Cumulative prior probability of each."""

    @staticmethod
    def of(discounting: Discounting, horizon: int, low: float, high: float) -> ForesightPrior:
        """The prior on [low, high], for a game of this many stages."""
        # The table is finest near the upper end, where a change of gamma means most stages.
        gamma = high - (high - low) * np.linspace(1.0, 0.0, POINTS) ** 2
        with jax.enable_x64(True):
            ratio = jax.vmap(lambda g: discounting.ratio(jnp.zeros(()), g))(jnp.asarray(gamma))
        beyond = np.maximum(1.0 - np.asarray(ratio), 0.0)
        log_horizon = -np.log(beyond + 1.0 / (LONGEST * horizon))
        # Discount factors above 1 are no longer a matter of horizons: uniform, as at 1.
        rate = np.diff(log_horizon) / np.diff(gamma)
        above = gamma[1:] > 1.0
        if above.any():
            rate = np.where(above, rate[~above].max(initial=1.0), rate)
        rank = np.concatenate([[0.0], np.cumsum(rate * np.diff(gamma))])
        return ForesightPrior(gamma, rank / rank[-1])

    def ranks(self, gamma: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
        """Ranks of discount factors."""
        return np.asarray(np.interp(gamma, self.gamma, self.rank))

    def at(self, rank: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
        """Discount factors with these ranks."""
        return np.asarray(np.interp(rank, self.rank, self.gamma))

    def density(self, gamma: float) -> float:
        """Of gamma: the rise of the rank per unit."""
        k = int(np.clip(np.searchsorted(self.gamma, gamma), 1, len(self.gamma) - 1))
        return float(np.diff(self.rank)[k - 1] / np.diff(self.gamma)[k - 1])
