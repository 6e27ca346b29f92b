"""Means with intervals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import bootstrap


class Interval(NamedTuple):
    """A mean and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def mean_interval(values: Float[np.ndarray, "n"], *, seed: int = 0) -> Interval:
    """Mean with a percentile bootstrap interval (Efron and Tibshirani, 1993, chapter 13).

    For a paired comparison pass the differences. NaN entries raise `ValueError`: leave out nothing
    silently.
    """
    data = np.asarray(values, dtype=float)
    if data.size == 0 or np.isnan(data).any():
        raise ValueError("values: empty or with NaN; decide what a missing value means first")
    mean = float(data.mean())
    if data.size < 2 or np.ptp(data) == 0.0:
        return Interval(mean, mean, mean)
    found = bootstrap(
        (data,), np.mean, n_resamples=2000, method="percentile", rng=np.random.default_rng(seed)
    ).confidence_interval
    return Interval(mean, float(found.low), float(found.high))
