"""Intervals of discount factors by profile likelihood.

Equilibria are piecewise smooth in their parameters: which bounds and collision terms are active
changes within the noise, and with it how much the data say. The Laplace approximation knows one
piece only; a profile walks over all of them. For each value of a discount factor every other
parameter is fitted anew; the interval is where the objective stays below its minimum plus a
quantile of the chi-squared distribution with one degree of freedom (Venzon and Moolgavkar, Applied
Statistics 37, 1988). A better minimum that is met on the way becomes the estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import chi2

from foresight_env.equilibrium.kkt import Parameters
from foresight_env.equilibrium.start import Start
from foresight_env.inverse.fit import Data, Fit, Problem, extrapolated
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.laplace import laplace
from foresight_env.inverse.multi_start import MOST_STARTS, search

NARROWEST, WIDEST = 5e-3, 0.25
"""Steps of a walk along a discount factor."""
GROWTH = 3.0
"""How many times as far as the last one a point may lie."""
CLOSE = 0.15
"""Relative error of `sqrt(rise)` at which a point counts as the interval's end."""
BETTER = 0.1
"""By how much a fit on the way has to be better to become the estimate: a chi-squared sum, in
which one deviation is 1."""
RENEWALS = 3
"""Better minima after which no more are followed."""


@dataclass(frozen=True)
class Profile:
    """Settings of `estimate`'s profile likelihood."""

    level: float = 0.9
    """Probability that an interval is to hold the truth with."""
    points: int = 8
    """Most values of a discount factor that are tried on each side of its estimate."""
    iterations: int = 8
    """Most Gauss-Newton steps per value."""

    def __post_init__(self) -> None:
        if not 0.0 < self.level < 1.0:
            raise ValueError(f"level: is {self.level}; expected between 0 and 1")
        for name in ("points", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: is {getattr(self, name)}; expected at least 1")

    @property
    def rise(self) -> float:
        """Of the objective, at an interval's end."""
        return float(chi2.ppf(self.level, 1))


class Profiled(NamedTuple):
    """The best fit that was met and, per player, the interval around it."""

    fit: Fit
    intervals: Float[np.ndarray, "N 2"]
    solves: int


Refit = Callable[[Float[np.ndarray, "p"], int | None, Fit], Fit]
"""Fit from parameters that start near a fit, all of them or all but one."""


@jax.jit
def _near(fit: Fit, values: Float[Array, "p"]) -> Start:
    return Start(extrapolated(fit, values), jax.numpy.asarray(True))


_laplace = jax.jit(laplace, static_argnums=0)


def profiled(
    problem: Problem, data: Data, base: Parameters, fit: Fit, method: GaussNewton, profile: Profile
) -> Profiled:
    """Walk from `fit` along every estimated discount factor, down and up."""
    solves = 0

    def refit(values: Float[np.ndarray, "p"], held: int | None, near: Fit) -> Fit:
        nonlocal solves
        free = np.array(data.free)
        if held is not None:
            free[held] = 0.0
        starts = np.tile(values, (MOST_STARTS, 1))
        kept = data._replace(free=free)
        quick = replace(method, max_iterations=profile.iterations, cost_tolerance=1e-3)
        found, spent, _ = search(
            problem, quick, kept, base, starts, np.asarray(1), _near(near, values)
        )
        solves += int(spent)
        return found

    gammas = np.flatnonzero(problem.coordinates.is_gamma)
    intervals = np.repeat(np.asarray(fit.values)[gammas, None], 2, axis=1)
    todo = [(player, side) for player in range(len(gammas)) for side in (0, 1)]
    todo = [(player, side) for player, side in todo if data.free[gammas[player]]]
    left, renewals = list(todo), 0
    while left:
        player, side = left.pop(0)
        end, better = _walk(
            problem, data, fit, int(gammas[player]), (-1.0, 1.0)[side], profile, refit
        )
        intervals[player, side] = end
        if better is not None and renewals < RENEWALS:
            polished = refit(np.asarray(better.values), None, better)
            fit = polished if polished.cost < better.cost else better
            renewals += 1
            left = list(todo)
    return Profiled(fit, intervals, solves)


def _walk(
    problem: Problem,
    data: Data,
    center: Fit,
    at: int,
    sign: float,
    profile: Profile,
    refit: Refit,
) -> tuple[float, Fit | None]:
    """Where the profile reaches its level on one side; or a better fit that was met before."""
    values, lowest = np.asarray(center.values), float(center.cost)
    wanted = np.sqrt(profile.rise)
    limit = float((data.low if sign < 0 else data.high)[at])
    reach = abs(limit - values[at])  # of the walk: all positions are distances from the center
    covariance = np.asarray(_laplace(problem, data, center)[0])
    slope = sign * covariance[at] / max(covariance[at, at], 1e-300)
    slope[at] = sign
    inside, root_inside, nearest = 0.0, 0.0, center
    outside, root_outside = np.inf, np.inf
    step = np.clip(wanted * np.sqrt(covariance[at, at]), NARROWEST, WIDEST)
    for _ in range(profile.points):
        if np.isfinite(root_outside):
            part = (wanted - root_inside) / (root_outside - root_inside)
            place = inside + (outside - inside) * np.clip(part, 0.1, 0.9)
        elif np.isfinite(outside):  # not solved there
            place = 0.5 * (inside + outside)
        else:
            place = inside + step
        place = min(place, reach)
        if place <= inside:
            break
        trial = np.asarray(nearest.values) + slope * (place - inside)
        trial[at] = values[at] + sign * place
        fit = refit(np.clip(trial, data.low, data.high), at, nearest)
        rise = float(fit.cost) - lowest
        if rise < -BETTER:
            return values[at] + sign * place, fit
        root = np.sqrt(max(rise, 0.0)) if fit.success else np.inf
        if root >= wanted:
            outside, root_outside = place, root
        else:
            slope = (np.asarray(fit.values) - np.asarray(nearest.values)) / (place - inside)
            step = place * np.clip(1.05 * wanted / max(root, 1e-6), 1.1, GROWTH) - place
            step = np.clip(step, NARROWEST, WIDEST)
            inside, root_inside, nearest = place, root, fit
            if place == reach:
                break
        if abs(root - wanted) <= CLOSE * wanted:
            break
    if np.isfinite(root_outside):
        part = (wanted - root_inside) / (root_outside - root_inside)
        return values[at] + sign * (inside + (outside - inside) * part), None
    # Never left: the limit; not solved beyond: the nearest place that was not.
    return values[at] + sign * min(outside, reach), None
