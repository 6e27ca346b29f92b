"""Means of Gaussian distributions in boxes, by Gibbs sampling of the bounded entries."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from foresight_env.inverse.settings import GibbsSettings


def truncated_means(
    means: Float[np.ndarray, "S p"],
    covariances: Float[np.ndarray, "S p p"],
    low: Float[np.ndarray, "p"],
    high: Float[np.ndarray, "p"],
    seed: int = 0,
    settings: GibbsSettings = GibbsSettings(),
) -> Float[np.ndarray, "S p"]:
    """Means of S Gaussian distributions, each truncated to `low <= v <= high`.

    Only entries with a finite limit are sampled; the others' conditional means are linear in them.
    An entry of variance 0 keeps its mean, moved into the box.
    """
    moving = np.all(np.einsum("spp->sp", covariances) > 0.0, axis=0)
    bounded = np.flatnonzero((np.isfinite(low) | np.isfinite(high)) & moving)
    if not bounded.size:
        return np.clip(means, low, high)
    block = covariances[:, bounded[:, None], bounded]
    precision = np.linalg.inv(block)
    least, most = low[bounded], high[bounded]
    center = np.repeat(means[:, bounded], settings.chains, axis=0)
    matrix = np.repeat(precision, settings.chains, axis=0)
    random = np.random.default_rng(seed)
    values = np.clip(center, least, most)
    total = np.zeros_like(values)
    for sweep in range(settings.sweeps):
        for k in range(bounded.size):
            own = matrix[:, k, k]
            others = np.einsum("sj,sj->s", matrix[:, k], values - center)
            middle = values[:, k] - others / own
            deviation = own**-0.5
            # The lower tail keeps its digits: distributions beyond the upper limit are mirrored.
            flip = np.where(middle > most[k], -1.0, 1.0)
            a = np.where(flip > 0.0, least[k] - middle, middle - most[k]) / deviation
            b = np.where(flip > 0.0, most[k] - middle, middle - least[k]) / deviation
            mirrored = np.where(a > 0.0, -1.0, 1.0)
            a, b = np.where(a > 0.0, -b, a), np.where(a > 0.0, -a, b)
            from_, to = ndtr(a), ndtr(b)
            drawn = ndtri(np.maximum(from_ + random.random(len(a)) * (to - from_), 1e-300))
            drawn = np.clip(drawn, a, b) * mirrored * flip
            values[:, k] = np.clip(middle + deviation * drawn, least[k], most[k])
        if sweep >= settings.burn_in:
            total += values
    found = total.reshape(len(means), settings.chains, -1).mean(axis=1) / (
        settings.sweeps - settings.burn_in
    )
    shift = np.einsum("sij,sj->si", precision, found - means[:, bounded])
    moved = means + np.einsum("spj,sj->sp", covariances[:, :, bounded], shift)
    moved[:, bounded] = found
    return np.clip(moved, low, high)
