"""Calibration of a forecast with covariances: coverage of its highest-density regions.

A forecast's density for one agent at one step is a mixture of Gaussians, so a region of nominal
probability q is the smallest one: all places whose density is above the level at which they hold
probability q together (Hyndman, "Computing and graphing highest density regions", The American
Statistician 1996). A place lies in it when at most q of the forecast's probability is at places of
higher density. That share, the place's *level*, is uniform on [0, 1] when the forecast is
calibrated; the most likely future's chi-squared distance alone would ignore the other futures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from evaluation.metrics.trajectory import LEAST_DEVIATION, log_densities

BINS = 20
"""Levels are counted in this many equal bins."""
DRAWS = 399
"""Places drawn from a mixture. One less than a multiple of `BINS`, so that ranks of calibrated
forecasts fill the bins evenly."""
SEED = 0
NOMINAL = (0.5, 0.9)
"""Probabilities of the regions whose coverage tables have."""


def density_levels(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    covariance: Float[np.ndarray, "M K A 2 2"],
    truth: Float[np.ndarray, "K A 2"],
) -> Float[np.ndarray, "K A"]:
    """Level of the truth for each step and agent: the forecast's probability of higher densities.

    Exact for one Gaussian, `1 - exp(-d^2 / 2)` at the Mahalanobis distance d. For a mixture the
    truth's rank among `DRAWS` places drawn from it, of the same seed always. Covariances are
    increased by `LEAST_DEVIATION`, as for the likelihood. `truth`: m, without NaN.
    """
    wide = covariance + LEAST_DEVIATION**2 * np.eye(2)
    if len(probabilities) == 1:
        error = truth - positions[0]
        across = np.linalg.solve(wide[0], error[..., None])[..., 0]
        return np.asarray(1.0 - np.exp(-0.5 * np.sum(error * across, axis=-1)))
    random = np.random.default_rng(SEED)
    mode = random.choice(len(probabilities), DRAWS, p=probabilities / probabilities.sum())
    normal = random.standard_normal((DRAWS, *truth.shape))
    roots = np.linalg.cholesky(wide)
    places = positions[mode] + np.einsum("skaij,skaj->skai", roots[mode], normal)
    drawn = log_densities(positions, probabilities, covariance, places)
    true = log_densities(positions, probabilities, covariance, truth[None])
    return np.asarray((np.sum(drawn > true, axis=0) + 0.5) / (DRAWS + 1))


def level_counts(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    covariance: Float[np.ndarray, "M K A 2 2"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
) -> list[int]:
    """How many steps and agents have their truth's level in each of `BINS` bins of [0, 1]."""
    places = np.where(present[..., None], truth, 0.0)
    levels = density_levels(positions, probabilities, covariance, places)[present]
    bins = np.clip(np.ceil(BINS * levels).astype(int) - 1, 0, BINS - 1)
    return [int(n) for n in np.bincount(bins, minlength=BINS)]


def coverage(counts: Sequence[Sequence[int]]) -> Float[np.ndarray, "_"]:
    """Observed coverage of the regions of nominal probability 1 / `BINS`, 2 / `BINS`, ..., 1.

    `counts`: of `level_counts`, one per window, at least one with a counted step.
    """
    total = np.sum(np.asarray(counts, dtype=float), axis=0)
    return np.asarray(np.cumsum(total) / total.sum())
