"""Adaptive importance sampling of a density on the unit cube.

Each round draws from a truncated Student distribution with the mean and the covariance of what was
weighted so far; all rounds are weighted together by the mixture that they were drawn from (Cornuet,
Marin, Mira and Robert, "Adaptive multiple importance sampling", Scand. J. Statist. 39, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_t, norm, qmc

from foresight_env.inverse.settings import ProposalSettings


@dataclass(frozen=True, eq=False)
class Proposal:
    """Student distribution on the unit cube."""

    mean: Float[np.ndarray, "N"]
    scale: Float[np.ndarray, "N N"]
    log_mass: float
    """Logarithm of the untruncated distribution's probability of the cube."""
    settings: ProposalSettings = ProposalSettings()

    @staticmethod
    def of(
        mean: Float[np.ndarray, "N"],
        covariance: Float[np.ndarray, "N N"],
        settings: ProposalSettings = ProposalSettings(),
    ) -> Proposal:
        """With this mean, and a covariance whose deviations are limited."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        limited = np.clip(deviation, settings.least_deviation, settings.most_deviation)
        correlation = settings.correlation * covariance / np.outer(deviation, deviation)
        np.fill_diagonal(correlation, 1.0)
        scale = correlation * np.outer(limited, limited)
        spectrum, basis = np.linalg.eigh(scale)
        scale = (basis * np.maximum(spectrum, settings.flattest * spectrum[-1])) @ basis.T
        untruncated = Proposal(mean, scale, 0.0, settings)
        most = settings.candidates
        inside = np.mean(_in_cube(untruncated.untruncated_draws(most, 0)))
        return Proposal(mean, scale, float(np.log(max(inside, 1.0 / most))), settings)

    def untruncated_draws(self, count: int, seed: int) -> Float[np.ndarray, "S N"]:
        """Low-discrepancy draws; the same for the same seed."""
        size, freedom = self.mean.size, self.settings.freedom
        points = qmc.Sobol(size + 1, seed=seed).random(1 << int(np.ceil(np.log2(count))))[:count]
        points = np.clip(points, 1e-6, 1.0 - 1e-6)
        normal = norm.ppf(points[:, :size])
        radius = np.sqrt(freedom / chi2.ppf(points[:, size], freedom))
        return self.mean + radius[:, None] * normal @ np.linalg.cholesky(self.scale).T

    def draws(self, count: int, seed: int) -> Float[np.ndarray, "S N"]:
        """The first `count` draws inside the cube."""
        drawn = self.untruncated_draws(self.settings.candidates, seed)
        inside = drawn[_in_cube(drawn)]
        return inside[:count]

    def log_density(self, points: Float[np.ndarray, "S N"]) -> Float[np.ndarray, "S"]:
        """Of the truncated distribution."""
        density = multivariate_t(self.mean, self.scale, self.settings.freedom)
        return np.atleast_1d(density.logpdf(points)) - self.log_mass


def mixture_weights(
    log_target: Float[np.ndarray, "S"],
    points: Float[np.ndarray, "S N"],
    proposals: list[tuple[Proposal, int]],
) -> Float[np.ndarray, "S"]:
    """Normalised weights of points that were drawn from proposals in these numbers.

    `log_target`: logarithm of the density up to a constant; minus infinity counts as 0.
    """
    total = sum(count for _, count in proposals)
    parts = [p.log_density(points) + np.log(count / total) for p, count in proposals]
    logs = log_target - logsumexp(parts, axis=0)
    weights = np.exp(logs - np.max(logs))
    return weights / weights.sum()


def adapted(
    points: Float[np.ndarray, "S N"],
    weights: Float[np.ndarray, "S"],
    settings: ProposalSettings = ProposalSettings(),
) -> Proposal:
    """The next proposal: the weighted points' mean and covariance, somewhat wider."""
    mean = weights @ points
    away = points - mean
    # With few effective points the covariance is shrunk towards its diagonal.
    effective = 1.0 / np.sum(weights**2)
    covariance = (weights[:, None] * away).T @ away
    trust = effective / (effective + 2.0 * mean.size)
    covariance = trust * covariance + (1.0 - trust) * np.diag(np.diag(covariance))
    return Proposal.of(mean, covariance * settings.wider**2 * (1.0 + 1.0 / effective), settings)


def weighted_interval(
    values: Float[np.ndarray, "S"], weights: Float[np.ndarray, "S"], level: float
) -> Float[np.ndarray, "2"]:
    """Equal-tailed interval of weighted samples."""
    order = np.argsort(values)
    values, weights = values[order], weights[order]
    # The middle of each sample's weight: extremes are reached only with all of the mass.
    place = np.cumsum(weights) - 0.5 * weights
    return np.interp([0.5 - 0.5 * level, 0.5 + 0.5 * level], place, values)


def _in_cube(points: Float[np.ndarray, "S N"]) -> np.ndarray:
    return np.asarray(((points >= 0.0) & (points <= 1.0)).all(axis=1))
