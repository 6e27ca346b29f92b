"""Laplace covariance of a fit, and which parameters are identifiable."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.stats import norm

from foresight_env.inverse.coordinates import Coordinates
from foresight_env.inverse.fit import Data, Fit, Problem

OPEN_GAMMA_DEVIATION = 0.29
"""Data-only deviation above which a discount factor counts as open: that of a uniform guess on
[0, 1] (1 / sqrt(12)). A definition; `benchmarks.intervals` counts open ones."""

INTERVAL_LEVEL = 0.9
"""Probability that an interval is to hold the truth with, unless a profile has another; the level
of `benchmarks.intervals`."""
LEAST_INFORMATION = 1e-6
"""Added to the data's information, relative to the inverse square of the deviation at which a
parameter counts as open: a numerical guard, by which unobserved parameters have a finite deviation,
a thousand times that one."""
ROUNDING = 1e-12
"""Least information relative to the largest: a numerical guard near rounding."""


def is_identifiable(coordinates: Coordinates, information: Array, values: Array) -> Array:
    """(p,) which parameters the data alone identify.

    From the data's information matrix (no prior) each parameter's marginal deviation is computed; a
    discount factor is identifiable below `OPEN_GAMMA_DEVIATION`, any other parameter below
    `max(1, |value|)` in its own unit.
    """
    scale = jnp.maximum(jnp.abs(values), 1.0)
    limit = jnp.where(jnp.asarray(coordinates.is_gamma), OPEN_GAMMA_DEVIATION, scale)
    ridge = LEAST_INFORMATION / limit**2
    deviation = jnp.sqrt(jnp.diag(jnp.linalg.inv(information + jnp.diag(ridge))))
    return deviation < limit


def _inverse_of(information: Array, free: Array, floor: Array) -> Float[Array, "p p"]:
    """Inverse of the free entries' block; 0 elsewhere."""
    reduced = information * free[:, None] * free + jnp.diag(1.0 - free + floor)
    return jnp.linalg.inv(reduced) * free[:, None] * free


def laplace(problem: Problem, data: Data, fit: Fit) -> tuple[Float[Array, "p p"], Bool[Array, "p"]]:
    """Inverse of the Gauss-Newton information, prior included, and what is identifiable.

    Parameters that rest on a limit do not vary with the others, so they are left out of the
    inverse; how far the data allow them off that limit is their deviation without it.
    """
    seen = fit.residual.shape[0] - data.prior_root.shape[0]
    from_data = fit.jacobian[:seen].T @ fit.jacobian[:seen]
    information = fit.jacobian.T @ fit.jacobian
    floor = ROUNDING * jnp.maximum(jnp.max(jnp.diag(information)), ROUNDING)
    held = (fit.values <= data.low) | (fit.values >= data.high)
    free = jnp.where(held, 0.0, data.free)
    covariance = _inverse_of(information, free, floor)
    loose = jnp.diag(_inverse_of(information, jnp.asarray(data.free), floor))
    covariance += jnp.diag(jnp.where(held, loose, 0.0))
    return covariance, is_identifiable(problem.coordinates, from_data, fit.values)


def laplace_intervals(
    values: Float[np.ndarray, "N"],
    variances: Float[np.ndarray, "N"],
    low: Float[np.ndarray, "N"],
    high: Float[np.ndarray, "N"],
) -> Float[np.ndarray, "N 2"]:
    """Intervals at `INTERVAL_LEVEL`, within the limits; of width 0 where the variance is 0."""
    half = norm.ppf(0.5 + 0.5 * INTERVAL_LEVEL) * np.sqrt(np.maximum(variances, 0.0))
    return np.stack([np.maximum(values - half, low), np.minimum(values + half, high)], axis=1)
