"""Ranks, and how sure they are."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

DRAWS = 2000
LEAST_GROUPS = 5
"""Groups of dependent values below which resampling them means nothing."""


class Rank(NamedTuple):
    """A place among others, 1 the best, and the places that the data leave possible."""

    place: int
    low: int
    high: int


def ranks(
    values: Float[np.ndarray, "M n"],
    clusters: Sequence[Hashable],
    *,
    seed: int = 0,
    level: float = 0.95,
) -> list[Rank]:
    """Places of M methods by their means over the same n cases; less is better.

    A method's possible places follow from whom it differs from: all pairs with it at once, at this
    level (Mogstad et al., "Inference for ranks", Review of Economic Studies 2024), whole clusters
    of cases resampled. Equal means share the better place. With fewer than `LEAST_GROUPS` clusters
    every place is possible. NaN raises `ValueError`.
    """
    data = np.asarray(values, dtype=float)
    if np.isnan(data).any() or data.size == 0:
        raise ValueError("values: empty or with NaN; decide what a missing value means first")
    count = len(data)
    means = data.mean(axis=1)
    places = [1 + int(np.sum(means < mean)) for mean in means]
    _, group = np.unique([repr(c) for c in clusters], return_inverse=True)
    groups = int(group.max()) + 1
    if groups < LEAST_GROUPS or count == 1:
        return [Rank(place, 1, count) for place in places]
    sums = np.stack([np.bincount(group, weights=row) for row in data])
    sizes = np.bincount(group)
    drawn = np.random.default_rng(seed).integers(0, groups, (DRAWS, groups))
    again = sums[:, drawn].sum(axis=2) / sizes[drawn].sum(axis=1)
    found = []
    for j, place in enumerate(places):
        gap = np.delete(means - means[j], j)
        moved = np.delete(again - again[j], j, axis=0) - gap[:, None]
        spread = moved.std(axis=1)
        # Where all cases agree on a difference it has no spread, and rounding is none.
        spread = np.maximum(spread, 1e-12 * (1.0 + np.abs(gap)))
        limit = float(np.quantile((np.abs(moved) / spread[:, None]).max(axis=0), level))
        better, worse = gap < -limit * spread, gap > limit * spread
        found.append(Rank(place, 1 + int(better.sum()), count - int(worse.sum())))
    return found
