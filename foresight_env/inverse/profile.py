"""Intervals of discount factors by profile likelihood.

Equilibria are piecewise smooth in their parameters: which bounds and collision terms are active
changes within the noise, and with it how much the data say. The Laplace approximation knows one
piece only; a profile walks over all of them. For each value of a discount factor every other
parameter is fitted again; the interval is where the objective stays below its minimum plus a
quantile of the chi-squared distribution with one degree of freedom (Venzon and Moolgavkar, Applied
Statistics 37, 1988). A clearly better minimum that is met on the way becomes the estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.stats import chi2

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.newton.schedule import Limits
from foresight_env.equilibrium.newton.start import Start, from_controls
from foresight_env.inverse.fit import Data, Fit, Problem, extrapolated
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.laplace import laplace
from foresight_env.inverse.multi_start import MOST_STARTS, search
from foresight_env.inverse.settings import WalkSettings

AIM = 1.05
"""Ratio of the level that a step of a walk aims at: a twentieth past it, so that the end then lies
between two points. Structural, as the next two; `benchmarks.intervals` measures the intervals."""
LEAST_GROWTH = 1.1
"""Least ratio of a point's distance from the estimate to that of the one before: walks move on."""
INSET = 0.1
"""Least distance of a point from both ends of a bracket, as a part of it: brackets shrink."""


@dataclass(frozen=True)
class Profile:
    """Settings of `estimate`'s profile likelihood; `benchmarks.intervals` measures coverage."""

    level: float = 0.9
    """Probability that an interval is to hold the truth with."""
    points: int = 8
    """Most values of a discount factor that are tried on one walk. There is a walk on each side of
    each estimate, and all of them again from every better fit."""
    iterations: int = 8
    """Most Gauss-Newton steps per value; three times as many where a value seems to lie outside and
    is fitted again from a smoothed game."""
    walk: WalkSettings = WalkSettings()

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


Refit = Callable[..., Fit]
"""`refit(values, near, held=None, smoothed=False)`: the fit that is found from `values` on,
beginning near another fit, with parameters held or with a smoothed game first."""


@compiled(static_argnums=0)
def _begin(
    problem: Problem,
    base: Parameters,
    near: Fit,
    values: Array,
    smoothed: Array,
    limits: Limits,
) -> Start:
    """Near a solution moved along its derivatives, or the path from its controls."""

    def from_path() -> Iterate:
        parameters = problem.coordinates.unpack(values, base)
        return from_controls(problem.layout, problem.options, parameters, near.point.u)

    point = jax.lax.cond(smoothed, from_path, lambda: extrapolated(near, values))
    return Start(point, ~smoothed, limits=limits)


_laplace = compiled(static_argnums=0)(laplace)


def refitting(
    problem: Problem,
    data: Data,
    base: Parameters,
    method: GaussNewton,
    iterations: int,
    limits: Limits,
    walk: WalkSettings = WalkSettings(),
) -> tuple[Refit, Callable[[], int]]:
    """Fits with some parameters held, of so many Gauss-Newton steps, and their forward solves."""
    solves = 0
    walking = replace(
        method,
        max_iterations=iterations,
        cost_tolerance=walk.tolerance,
        initial_cost_limit=np.inf,
    )
    thorough = replace(walking, max_iterations=walk.from_smoothed * iterations)

    def refit(
        values: Float[np.ndarray, "p"],
        near: Fit,
        held: int | Int[np.ndarray, "N"] | None = None,
        smoothed: bool = False,
    ) -> Fit:
        nonlocal solves
        free = np.array(data.free)
        if held is not None:
            free[held] = 0.0
        found, spent, _ = search(
            problem,
            thorough if smoothed else walking,
            data._replace(free=free),
            base,
            np.tile(values, (MOST_STARTS, 1)),
            np.asarray(1),
            _begin(problem, base, near, values, np.asarray(smoothed), limits),
        )
        solves += int(spent)
        return found

    return refit, lambda: solves


def profiled(
    problem: Problem,
    data: Data,
    base: Parameters,
    fit: Fit,
    method: GaussNewton,
    profile: Profile,
    limits: Limits,
) -> Profiled:
    """Walk from `fit` along every estimated discount factor, down and up."""
    walk = profile.walk
    refit, spent = refitting(problem, data, base, method, profile.iterations, limits, walk)
    gammas = np.flatnonzero(problem.coordinates.is_gamma)
    intervals = np.repeat(np.asarray(fit.values)[gammas, None], 2, axis=1)
    sides = [(player, side) for player in range(len(gammas)) for side in (0, 1)]
    sides = [(player, side) for player, side in sides if data.free[gammas[player]]]
    left, renewals = list(sides), 0
    while left:
        player, side = left.pop(0)
        at = int(gammas[player])
        limit = float((data.low, data.high)[side][at])
        covariance = np.asarray(_laplace(problem, data, fit)[0])
        best, end = _walk(fit, at, limit, covariance, profile, refit, renewals < walk.renewals)
        intervals[player, side] = end
        if best is not fit:
            # Its Jacobian lacks the parameter that was held: it is fitted again with all of them.
            polished = refit(np.asarray(best.values), best)
            renewals += 1
            left = [(player, side), *left]
            if polished.cost < fit.cost:
                fit, left = polished, list(sides)
    return Profiled(fit, intervals, spent())


def _walk(
    center: Fit,
    at: int,
    limit: float,
    covariance: Float[np.ndarray, "p p"],
    profile: Profile,
    refit: Refit,
    follow: bool,
) -> tuple[Fit, float]:
    """The center, and where the profile reaches its level on the way to a parameter's `limit`.

    With `follow`, a fit on the way that is better is returned instead of the center, the best one
    before the profile rises again; the end then means nothing. An end that is not found, since
    games are not solved there or `profile.points` are used up, is the range's.
    """
    origin, best = float(center.values[at]), center
    walk = profile.walk
    wanted, reach, sign = np.sqrt(profile.rise), abs(limit - origin), np.sign(limit - origin)
    if reach == 0.0:
        return center, limit
    slope = sign * covariance[at] / max(covariance[at, at], 1e-300)
    slope[at] = sign
    # Places are distances from the center; roots are of the rise, and linear in them near it.
    inside, root_inside, nearest = 0.0, 0.0, center
    outside, root_outside = np.inf, np.inf
    step = np.clip(wanted * np.sqrt(covariance[at, at]), walk.narrowest, walk.widest)
    for _ in range(profile.points):
        if np.isfinite(root_outside):
            place = _between(inside, outside, (wanted - root_inside) / (root_outside - root_inside))
        elif np.isfinite(outside):  # no game was solved there
            place = _between(inside, outside, 0.5)
        else:
            place = min(inside + step, reach)
        trial = np.asarray(nearest.values) + slope * (place - inside)
        trial[at] = origin + sign * place
        fit = refit(trial, nearest, held=at)
        if not fit.cost < best.cost + profile.rise:
            again = refit(trial, nearest, held=at, smoothed=True)
            fit = again if again.cost < fit.cost else fit
        if follow and fit.cost < best.cost - walk.better:
            best = fit
        elif best is not center:
            return best, limit
        root = np.sqrt(max(float(fit.cost - best.cost), 0.0)) if fit.success else np.inf
        if root >= wanted:
            outside, root_outside = place, root
        else:
            slope = (np.asarray(fit.values) - np.asarray(nearest.values)) / (place - inside)
            growth = np.clip(AIM * wanted / max(root, 1e-6), LEAST_GROWTH, walk.growth)
            step = np.clip((growth - 1.0) * place, walk.narrowest, walk.widest)
            inside, root_inside, nearest = place, root, fit
        if inside >= reach or abs(root - wanted) <= walk.close * wanted:
            break
    end = reach
    if np.isfinite(root_outside):
        part = (wanted - root_inside) / (root_outside - root_inside)
        end = inside + part * (outside - inside)
    elif root_inside >= (1.0 - walk.close) * wanted:
        end = inside * wanted / root_inside
    return best, float(np.clip(origin + sign * end, min(origin, limit), max(origin, limit)))


def _between(low: float, high: float, part: float) -> float:
    return low + (high - low) * float(np.clip(part, INSET, 1.0 - INSET))
