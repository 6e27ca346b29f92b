"""Metrics, each with its definition and source. Lengths in metres, times in seconds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp


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
    distance at the last step at which each is present. NaN when none is.
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


MISS_DISTANCE = 2.0
"""Farther off than this at the end, an agent's prediction is a miss (Argoverse, nuScenes), m."""


def displacement_until(
    predicted: Float[np.ndarray, "K A 2"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
    dt: float,
    seconds: float,
) -> tuple[float, float]:
    """ADE over the steps up to `seconds`, and FDE at that time, between steps by interpolation.

    Step k is `(k + 1) * dt` s away. NaN where no agent is present then; a time before the first
    step has no ADE.
    """
    gap = predicted - np.where(present[..., None], truth, np.nan)
    inside = dt * np.arange(1, len(gap) + 1) <= seconds * (1.0 + 1e-9)
    distance = np.linalg.norm(gap, axis=2)
    counted = distance[inside & present.any(axis=1)]
    average = float(np.nanmean(counted)) if counted.size else float("nan")
    place = seconds / dt - 1.0
    low = int(np.floor(place + 1e-9))
    part = max(place - low, 0.0)
    if low < 0 or low + (part > 1e-9) >= len(gap):
        return average, float("nan")
    at = gap[low] if part <= 1e-9 else (1.0 - part) * gap[low] + part * gap[low + 1]
    final = np.linalg.norm(at, axis=1)
    return average, float("nan") if np.isnan(final).all() else float(np.nanmean(final))


def missed(
    predicted: Float[np.ndarray, "K A 2"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
) -> Bool[np.ndarray, "A"]:
    """Whose prediction is off by more than `MISS_DISTANCE` at the last step at which it is present.

    Agents that are never present are not missed.
    """
    rows = np.arange(len(present))[:, None]
    last = np.where(present, rows, -1).max(axis=0)
    agents = np.arange(present.shape[1])
    gap = np.linalg.norm(predicted[last, agents] - truth[last, agents], axis=1)
    return np.asarray((last >= 0) & (gap > MISS_DISTANCE))


LEAST_DEVIATION = 0.05
"""Standard deviation (m) that is added to a forecast's: positions are not recorded more exactly,
and a forecast that is certain and wrong would have no likelihood at all."""


def negative_log_likelihood(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    covariance: Float[np.ndarray, "M K A 2 2"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
) -> float:
    """Mean over steps and agents of `-log p(truth)`, p a mixture of Gaussians in m^-2 (NLL).

    Each step and agent by itself (Ivanovic and Pavone, "The Trajectron", ICCV 2019). NaN when
    no agent is present.
    """
    if not present.any():
        return float("nan")
    places = np.where(present[..., None], truth, 0.0)
    likelihood = log_densities(positions, probabilities, covariance, places[None])[0]
    return float(-likelihood[present].mean())


def log_densities(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    covariance: Float[np.ndarray, "M K A 2 2"],
    places: Float[np.ndarray, "S K A 2"],
) -> Float[np.ndarray, "S K A"]:
    """Logarithm of a forecast's density (m^-2) at S places for each step and agent.

    Each step and agent by itself: a mixture of Gaussians with covariances increased by
    `LEAST_DEVIATION`.
    """
    wide = covariance + LEAST_DEVIATION**2 * np.eye(2)
    inverse, determinant = np.linalg.inv(wide), np.linalg.slogdet(wide)[1]
    error = places[:, None] - positions
    across = error[..., 0], error[..., 1]
    distance = (
        inverse[..., 0, 0] * across[0] ** 2
        + 2.0 * inverse[..., 0, 1] * across[0] * across[1]
        + inverse[..., 1, 1] * across[1] ** 2
    )
    density = -0.5 * distance - 0.5 * determinant - np.log(2.0 * np.pi)
    with np.errstate(divide="ignore"):
        weighted = density + np.log(probabilities)[:, None, None]
    return np.asarray(logsumexp(weighted, axis=1))


def best_displacement(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    truth: Float[np.ndarray, "K A 2"],
    present: Bool[np.ndarray, "K A"],
    count: int,
) -> tuple[float, float]:
    """minADE_k and minFDE_k: `displacement` of the best joint future among the `count` most likely.

    Chosen by ADE, all agents together (Gupta et al., "Social GAN", CVPR 2018).
    """
    most_likely = np.argsort(-probabilities, kind="stable")[:count]
    return min(displacement(positions[m], truth, present) for m in most_likely)


class BestOfAgents(NamedTuple):
    """Errors of A agents, each by itself; m."""

    average: Float[np.ndarray, "A"]
    """minADE_k of each agent."""
    final: Float[np.ndarray, "A"]
    """minFDE_k of each agent, not necessarily of the future with its least ADE."""


def best_of_agents(
    positions: Float[np.ndarray, "M K A 2"],
    probabilities: Float[np.ndarray, "M"],
    truth: Float[np.ndarray, "K A 2"],
    count: int,
) -> BestOfAgents:
    """minADE_k and minFDE_k of each agent among the `count` most likely futures.

    Each agent and each of the two metrics has its own best future, as in most results on ETH/UCY
    (Salzmann et al., "Trajectron++", ECCV 2020, section 5). Social GAN's code takes the best future
    of a whole window instead. `truth`: without NaN.
    """
    most_likely = np.argsort(-probabilities, kind="stable")[:count]
    gap = np.linalg.norm(positions[most_likely] - truth, axis=3)
    return BestOfAgents(gap.mean(axis=1).min(axis=0), gap[:, -1].min(axis=0))


STANDING = 0.1
"""Slower than this a car counts as standing, m/s."""


def at_fault(states: Float[np.ndarray, "N 4"], ego: int) -> bool:
    """Whether the ego caused a contact: it moved, and the nearest other was ahead of its middle.

    Who is hit from behind, or stands, is not at fault (Caesar et al., "NuPlan", 2021, in short).
    `states`: `[px, py, v, psi]` when the contact was found, m, m/s, rad.
    """
    away = states[:, :2] - states[ego, :2]
    distance = np.linalg.norm(away, axis=1)
    distance[ego] = np.inf
    ahead = away[int(np.argmin(distance))] @ [np.cos(states[ego, 3]), np.sin(states[ego, 3])]
    return bool(states[ego, 2] > STANDING and ahead > 0.0)


class RideComfort(NamedTuple):
    """How a ride feels; root mean squares over an episode."""

    acceleration: float
    """Along the car, m/s^2."""
    jerk: float
    """Its change, m/s^3."""
    lateral: float
    """Acceleration across the car, `v` times the yaw rate, m/s^2."""


def comfort(states: Float[np.ndarray, "K 4"], dt: float) -> RideComfort:
    """Of one car's `[px, py, v, psi]` at even times; at least three of them, or NaN."""
    if len(states) < 3:
        return RideComfort(np.nan, np.nan, np.nan)
    acceleration = np.diff(states[:, 2]) / dt
    across = states[:-1, 2] * np.diff(states[:, 3]) / dt

    def size(values: Float[np.ndarray, "L"]) -> float:
        return float(np.sqrt(np.mean(values**2)))

    return RideComfort(size(acceleration), size(np.diff(acceleration) / dt), size(across))


def lateral_acceleration(
    path: Float[np.ndarray, "P 2"], start: Float[np.ndarray, "2"], dt: float
) -> float:
    """Largest lateral acceleration along a path from `start`, m/s^2; NaN steps do not count.

    Change of the direction of travel between two steps, times the speed: 0 where the agent moves
    less than `STANDING` m/s, NaN where there are no two steps.
    """
    steps = np.diff(np.vstack([start, path]), axis=0)
    speed = np.hypot(*steps.T) / dt
    turn = np.diff(np.arctan2(steps[:, 1], steps[:, 0]))
    turn = np.mod(turn + np.pi, 2.0 * np.pi) - np.pi
    pace = np.minimum(speed[1:], speed[:-1])
    across = np.where(pace > STANDING, np.abs(turn) * pace / dt, 0.0)
    seen = ~np.isnan(turn)
    return float(across[seen].max()) if seen.any() else float("nan")
