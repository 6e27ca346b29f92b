"""Means with intervals."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binomtest, bootstrap


class Interval(NamedTuple):
    """A mean and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def clustered_interval(
    values: Float[np.ndarray, "n"], clusters: Sequence[Hashable], *, seed: int = 0
) -> Interval:
    """Mean of values that depend on each other within clusters: whole clusters are resampled.

    Davison and Hinkley, "Bootstrap Methods and their Application" (1997), section 3.8.
    """
    return stratified_interval([np.asarray(values, dtype=float)], [clusters], seed=seed)


def stratified_interval(
    values: Sequence[Float[np.ndarray, "_"]],
    clusters: Sequence[Sequence[Hashable]],
    *,
    seed: int = 0,
) -> Interval:
    """Mean of the strata's means, each weighing the same, with a bootstrap interval.

    Args:
        values: Of each stratum, such as a scene.
        clusters: The cluster of each value: whole clusters are resampled within their stratum
            (Davison and Hinkley, 1997, sections 3.2 and 3.8).
        seed: Of the resampling.

    Returns:
        Mean and 95 % interval.
    """
    random = np.random.default_rng(seed)
    total, means = np.zeros(2000), []
    for data, names in zip(values, clusters, strict=True):
        own, place = np.unique([repr(c) for c in names], return_inverse=True)
        sums, counts = np.bincount(place, weights=data), np.bincount(place)
        drawn = random.integers(0, len(own), (2000, len(own)))
        total += sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
        means.append(float(np.mean(data)))
    low, high = np.percentile(total / len(values), [2.5, 97.5])
    return Interval(float(np.mean(means)), float(low), float(high))


def share_interval(outcomes: Bool[np.ndarray, "n"]) -> Interval:
    """Share of independent cases in which an event occurred, with Wilson's interval (1927).

    Resampling would call "never in six cases" certain.
    """
    if outcomes.size == 0:
        raise ValueError("outcomes: is empty; expected at least one case")
    found = binomtest(int(outcomes.sum()), outcomes.size)
    low, high = found.proportion_ci(0.95, method="wilson")
    return Interval(float(found.statistic), float(low), float(high))


def mean_and_error(values: Float[np.ndarray, "n"], *, seed: int = 0) -> tuple[float, float]:
    """Mean and its bootstrap standard error (Efron and Tibshirani, 1993, chapter 6).

    0 for a single value, which says nothing of its spread.
    """
    data = np.asarray(values, dtype=float)
    if data.size == 0 or np.isnan(data).any():
        raise ValueError("values: empty or with NaN; decide what a missing value means first")
    if np.ptp(data) == 0.0:
        return float(data[0]), 0.0
    drawn = np.random.default_rng(seed).integers(0, data.size, (2000, data.size))
    return float(data.mean()), float(np.std(data[drawn].mean(axis=1)))


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


def ratio_interval(
    numerators: Float[np.ndarray, "n"], denominators: Float[np.ndarray, "n"], *, seed: int = 0
) -> Interval:
    """Ratio of two means of paired values, with a percentile bootstrap interval over the pairs.

    Davison and Hinkley, "Bootstrap Methods and their Application" (1997), section 2.4. Use it where
    the denominators' mean is surely not 0; resamples in which it is 0 are left out.
    """
    top, bottom = np.asarray(numerators, dtype=float), np.asarray(denominators, dtype=float)
    finite = np.isfinite(top).all() and np.isfinite(bottom).all()
    if not finite or top.size == 0 or bottom.sum() == 0.0:
        raise ValueError(
            "numerators, denominators: expected finite pairs, at least one, and denominators whose "
            "mean is not 0"
        )
    drawn = np.random.default_rng(seed).integers(0, top.size, (2000, top.size))
    sums = bottom[drawn].sum(axis=1)
    ratios = top[drawn].sum(axis=1)[sums != 0.0] / sums[sums != 0.0]
    low, high = np.percentile(ratios, [2.5, 97.5])
    return Interval(float(top.sum() / bottom.sum()), float(low), float(high))


def exact_mcnemar(first: Bool[np.ndarray, "n"], second: Bool[np.ndarray, "n"]) -> float:
    """Two-sided p-value that an event is as likely in both of two paired samples.

    Pairs in which it occurs in exactly one of the two count, by the binomial distribution (McNemar
    1947; Fay, "Two-sided exact tests and matching confidence intervals for discrete data", 2010).
    1 without such pairs.
    """
    once = int(np.sum(first & ~second)), int(np.sum(second & ~first))
    return float(binomtest(once[0], sum(once)).pvalue) if sum(once) else 1.0
