"""Metrics, each with its definition and source. Lengths in metres, times in seconds."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float


def trajectory_error(states: Float[np.ndarray, "K n"], truth: Float[np.ndarray, "K n"]) -> float:
    """`||X - X_true||^2` over all stages and state entries (paper, section VI-D)."""
    return float(np.sum((states - truth) ** 2))


def displacement(
    predicted: Float[np.ndarray, "K A 2"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
) -> tuple[float, float]:
    """Average and final displacement error, ADE and FDE (Pellegrini et al., ICCV 2009).

    ADE: mean distance over all steps and agents that are present. FDE: mean over agents of the
    distance at the last step at which each is present. NaN when nobody is.
    """
    gap = np.linalg.norm(predicted - np.where(present[..., None], truth, 0.0), axis=2)
    if not present.any():
        return float("nan"), float("nan")
    last = [
        gap[np.flatnonzero(present[:, a])[-1], a]
        for a in range(present.shape[1])
        if present[:, a].any()
    ]
    return float(gap[present].mean()), float(np.mean(last))
