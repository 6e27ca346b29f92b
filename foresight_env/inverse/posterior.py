"""Posterior mean: discount factors sampled, and trajectories averaged over what is left open.

The squared error of a trajectory is least, on average, for the mean of the trajectories that the
data leave open, not for that of the best fit: where noise is large, fits with nearly the same
objective differ much. Discount factors are sampled (module `importance`) under the prior of module
`foresight_prior`. For each sample all other parameters are fitted again; they count by the
Gaussian approximation about that fit, within their limits (module `truncated`): positions alone
leave initial velocities open up to the speed limit. A sample's weight is `exp(-objective / 2)`.
The other parameters' Laplace volume is left out of it: goals that the data leave open have no
finite one, and with Jeffreys' prior of them it cancels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.newton.start import Start
from foresight_env.inverse.fit import Data, Fit, Problem
from foresight_env.inverse.foresight_prior import ForesightPrior
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.importance import (
    Proposal,
    adapted,
    mixture_weights,
    weighted_interval,
)
from foresight_env.inverse.laplace import laplace
from foresight_env.inverse.multi_start import MOST_STARTS, search
from foresight_env.inverse.profile import refitting
from foresight_env.inverse.settings import SampleSettings, WalkSettings
from foresight_env.inverse.truncated import truncated_means


@dataclass(frozen=True)
class Posterior:
    """Settings of `estimate`'s posterior mean; `benchmarks.intervals` measures it."""

    samples: int = 64
    """Of the discount factors, in all rounds together; each takes 5 to 40 forward solves."""
    rounds: int = 4
    """Of sampling, each from what the ones before it found."""
    level: float = 0.9
    """Probability that an interval of a discount factor is to hold the truth with."""
    iterations: int = 16
    """Most Gauss-Newton steps of a sample's fit."""
    sampling: SampleSettings = SampleSettings()

    def __post_init__(self) -> None:
        if not 0.0 < self.level < 1.0:
            raise ValueError(f"level: is {self.level}; expected between 0 and 1")
        for name in ("samples", "rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: is {getattr(self, name)}; expected at least 1")
        if self.samples < self.rounds:
            raise ValueError(
                f"samples: is {self.samples}; expected at least one per round, {self.rounds}"
            )


class PosteriorMean(NamedTuple):
    """Averages over the posterior."""

    states: tuple[Float[np.ndarray, "stages _"], ...]
    """Mean trajectory per player: the estimate of least expected squared error, but itself no
    equilibrium."""
    gamma: Float[np.ndarray, "N"]
    """Mean discount factors."""
    values: Float[np.ndarray, "p"]
    """Means of the parameters, in the order of `Estimate.parameters`."""
    effective_samples: float
    """Kish's effective sample size: few (below 5) make intervals uncertain."""


class Sampled(NamedTuple):
    """Result of `sampled`, in the coordinates of a problem."""

    nearest: Fit
    """The sampled fit whose trajectory is nearest to the mean."""
    mean: PosteriorMean
    intervals: Float[np.ndarray, "N 2"]
    covariance: Float[np.ndarray, "p p"]
    """Between samples, and within them by the Laplace approximation."""
    identifiable: Bool[np.ndarray, "p"]
    """As at the best fit: samples hold the discount factors."""
    solves: int


class Search(NamedTuple):
    """Method, forward start and first parameters of the samples' fits."""

    method: GaussNewton
    start: Start
    """Of forward solves: the trajectory that follows the observations."""
    values: Float[np.ndarray, "p"]
    """The caller's start of the parameters."""


_laplace = compiled(static_argnums=0)(laplace)


def sampled(
    problem: Problem, data: Data, base: Parameters, mode: Fit, how: Search, posterior: Posterior
) -> Sampled:
    """Sample the free discount factors about `mode` and average over all that is free."""
    sampling = posterior.sampling
    at = np.flatnonzero(problem.coordinates.is_gamma & (np.asarray(data.free) > 0.0))
    held = np.array(data.free)
    held[at] = 0.0
    fitted, spent = _fitting(problem, data._replace(free=held), base, how, posterior)
    priors = _priors(problem, data, at)
    fits, points = [mode], [_ranks(priors, np.asarray(mode.values)[at])]
    weights = np.ones(1)
    spread, identifiable = (np.asarray(part) for part in _laplace(problem, data, mode))
    if at.size:
        slope = np.array(
            [p.density(float(v)) for p, v in zip(priors, mode.values[at], strict=True)]
        )
        first = sampling.first_deviation**2 * spread[np.ix_(at, at)] * np.outer(slope, slope)
        proposals: list[tuple[Proposal, int]] = []
        counts = np.diff(np.linspace(0, posterior.samples, posterior.rounds + 1).astype(int))
        for number, count in enumerate(counts):
            ranks = np.array(points)
            proposal = (
                adapted(ranks, weights, sampling.proposal)
                if number
                else Proposal.of(ranks[0], first, sampling.proposal)
            )
            drawn = proposal.draws(int(count), number)
            proposals.append((proposal, len(drawn)))
            for point in drawn:
                values = _at(priors, point)
                fits.append(fitted(values, at, fits, np.sum((ranks - point) ** 2, axis=1) ** 0.5))
                points.append(point)
                ranks = np.array(points)
            weights = _weights(fits, np.array(points), proposals)
    kept = np.flatnonzero(weights > sampling.negligible)
    averages = _averages(
        problem,
        data._replace(free=held),
        base,
        [fits[k] for k in kept],
        weights[kept] / weights[kept].sum(),
        lambda k, w: priors[k].at(weighted_interval(np.array(points)[kept, k], w, posterior.level)),
        at,
        spent(),
        sampling,
    )
    return averages._replace(identifiable=identifiable)


def _fitting(
    problem: Problem, held: Data, base: Parameters, how: Search, posterior: Posterior
) -> tuple[Callable[..., Fit], Callable[[], int]]:
    """Fits of the other parameters at given discount factors, and their forward solves."""
    assert how.start.limits is not None
    iterations, sampling = posterior.iterations, posterior.sampling
    walk = WalkSettings(tolerance=sampling.tolerance)
    refit, spent = refitting(problem, held, base, how.method, iterations, how.start.limits, walk)
    method = replace(how.method, max_iterations=iterations, cost_tolerance=sampling.tolerance)
    solves = 0

    def fitted(
        gamma: Float[np.ndarray, "f"],
        at: Int[np.ndarray, "f"],
        fits: list[Fit],
        distance: Float[np.ndarray, "S"],
    ) -> Fit:
        nonlocal solves
        solved = np.array([bool(f.success) for f in fits])
        nearest = int(np.argmin(np.where(solved, distance, np.inf)))
        if distance[nearest] < sampling.close:
            values = np.array(fits[nearest].values)
            values[at] = gamma
            found = refit(values, fits[nearest])
            if found.success:
                return found
        values = np.array(how.values)
        values[at] = gamma
        tiled = np.tile(values, (MOST_STARTS, 1))
        found, count, _ = search(problem, method, held, base, tiled, np.asarray(1), how.start)
        solves += int(count)
        return found

    return fitted, lambda: solves + spent()


def _priors(problem: Problem, data: Data, at: Int[np.ndarray, "f"]) -> list[ForesightPrior]:
    game = problem.layout.game
    players = np.searchsorted(np.flatnonzero(problem.coordinates.is_gamma), at)
    return [
        ForesightPrior.of(
            game.players[i].discounting, game.horizon, float(data.low[k]), float(data.high[k])
        )
        for i, k in zip(players, at, strict=True)
    ]


def _ranks(priors: list[ForesightPrior], gamma: np.ndarray) -> Float[np.ndarray, "f"]:
    return np.array([float(p.ranks(np.array(v))) for p, v in zip(priors, gamma, strict=True)])


def _at(priors: list[ForesightPrior], ranks: np.ndarray) -> Float[np.ndarray, "f"]:
    return np.array([float(p.at(np.array(r))) for p, r in zip(priors, ranks, strict=True)])


def _weights(
    fits: list[Fit], points: Float[np.ndarray, "S f"], proposals: list[tuple[Proposal, int]]
) -> Float[np.ndarray, "S"]:
    """Normalised; the mode was not drawn, and counts only where no sample is solved."""
    cost = np.array([float(f.cost) if f.success else np.inf for f in fits])
    if np.isinf(cost[1:]).all():
        return np.eye(len(fits))[0]
    cost[0] = np.inf
    return mixture_weights(-0.5 * cost, points, proposals)


def _averages(
    problem: Problem,
    held: Data,
    base: Parameters,
    fits: list[Fit],
    weights: Float[np.ndarray, "S"],
    interval: Callable[[int, np.ndarray], Float[np.ndarray, "2"]],
    at: Int[np.ndarray, "f"],
    solves: int,
    sampling: SampleSettings,
) -> Sampled:
    values = _conditional_means(held, fits, sampling)
    states = np.array([_states(problem, base, f, v) for f, v in zip(fits, values, strict=True)])
    mean, center = np.tensordot(weights, states, 1), weights @ values
    own = [_states(problem, base, f, np.asarray(f.values)) for f in fits]
    nearest = fits[int(np.argmin([np.sum((s - mean) ** 2) for s in own]))]
    within = [
        w * np.asarray(_laplace(problem, held, f)[0]) for w, f in zip(weights, fits, strict=True)
    ]
    away = values - center
    gammas = np.flatnonzero(problem.coordinates.is_gamma)
    intervals = np.repeat(center[gammas, None], 2, axis=1)
    for k, place in enumerate(np.searchsorted(gammas, at)):
        intervals[place] = interval(k, weights)
    averages = PosteriorMean(
        tuple(mean[:, s] for s in problem.layout.state_slices),
        center[gammas],
        center,
        float(1.0 / np.sum(weights**2)),
    )
    covariance = np.sum(within, axis=0) + (weights[:, None] * away).T @ away
    unknown = np.zeros(center.size, dtype=bool)
    return Sampled(nearest, averages, intervals, covariance, unknown, solves)


def _states(
    problem: Problem, base: Parameters, fit: Fit, values: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "stages n"]:
    """The trajectory at other parameters, to first order."""
    first = np.asarray(problem.coordinates.unpack(jnp.asarray(values), base).initial_state)
    later = np.asarray(fit.point.x)
    later = later + np.tensordot(values - np.asarray(fit.values), np.asarray(fit.rates.x), 1)
    return np.concatenate([first[None], later])


def _conditional_means(
    held: Data, fits: list[Fit], sampling: SampleSettings
) -> Float[np.ndarray, "S p"]:
    """Means of the parameters at given discount factors, within their limits."""
    free = np.flatnonzero(np.asarray(held.free) > 0.0)
    values = np.array([f.values for f in fits])
    if not free.size:
        return values
    means, covariances = [], []
    for fit, v in zip(fits, values, strict=True):
        jacobian = np.asarray(fit.jacobian)[:, free]
        information = jacobian.T @ jacobian
        diagonal = np.diag(information)
        scale = np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-300)))
        unit = information / np.outer(scale, scale) + sampling.ridge * np.eye(free.size)
        covariance = np.linalg.inv(unit) / np.outer(scale, scale)
        covariances.append(covariance)
        means.append(v[free] - covariance @ (jacobian.T @ np.asarray(fit.residual)))
    low, high = np.asarray(held.low)[free], np.asarray(held.high)[free]
    values[:, free] = truncated_means(
        np.array(means), np.array(covariances), low, high, settings=sampling.gibbs
    )
    return values
