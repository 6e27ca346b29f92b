"""The inverse problem: from observations to discount factors and cost parameters, with doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.stats import qmc

from foresight_env.equilibrium.implicit import Equilibrium
from foresight_env.equilibrium.interior_point import Options
from foresight_env.equilibrium.kkt import Iterate, Parameters
from foresight_env.equilibrium.layout import layout_of
from foresight_env.equilibrium.solve import Solution, check_guess, to_solution
from foresight_env.equilibrium.start import Start, from_controls
from foresight_env.equilibrium.status import Status
from foresight_env.equilibrium.validation import check_parameters
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.coordinates import Coordinates, Free
from foresight_env.inverse.fit import Data, Fit, Problem, unevaluated
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent
from foresight_env.inverse.prior import Prior, prior_terms
from foresight_env.inverse.tracking import track
from foresight_env.inverse.validation import check_observations, check_start
from foresight_env.precision import to_numpy


class Estimate(NamedTuple):
    """Estimated parameters, how certain they are, and the trajectory that they imply."""

    theta: tuple[Theta, ...]
    gamma: Float[np.ndarray, "N"]
    initial_state: tuple[Float[np.ndarray, "_"], ...]
    solution: Solution
    """The equilibrium at the estimate: the past explained, the rest of the horizon predicted."""
    cost: Float[np.ndarray, ""]
    """Value of the objective (paper, problem 1, prior included)."""
    names: tuple[str, ...]
    """Names of the p free parameters, in the order of `values` and `covariance`."""
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    """Laplace approximation: inverse of the Gauss-Newton information, prior included."""
    determined: Bool[np.ndarray, "p"]
    """False where the data leave a parameter open; see `is_determined`."""
    state_jacobian: Float[np.ndarray, "stages n p"]
    """Derivative of the joint trajectory by the free parameters."""
    status: Int[np.ndarray, ""]
    """`Status.SOLVED` when some start found a fit whose game was solved."""
    iterations: Int[np.ndarray, ""]
    """Forward solves, all starts together."""
    start_costs: Float[np.ndarray, "S"]
    """Objective reached from each start; infinite where solves failed or the start was spared."""

    @property
    def deviation(self) -> Float[np.ndarray, "p"]:
        """Standard deviation of each free parameter."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def state_deviation(self) -> tuple[Float[np.ndarray, "stages _"], ...]:
        """Standard deviation of the trajectory that `covariance` implies, per player."""
        rates = self.state_jacobian
        variance = np.einsum("tnp,pq,tnq->tn", rates, self.covariance, rates)
        ends = np.cumsum([s.shape[1] for s in self.solution.states])[:-1]
        return tuple(np.split(np.sqrt(np.maximum(variance, 0.0)), ends, axis=1))

    @property
    def gamma_deviation(self) -> Float[np.ndarray, "N"]:
        """Standard deviation of each discount factor; 0 where it is fixed."""
        out = np.zeros(len(self.gamma))
        for name, value in zip(self.names, self.deviation, strict=True):
            if name.startswith("gamma of "):
                out[int(name.split()[-1])] = value
        return out


@dataclass(frozen=True)
class MultiStart:
    """Local fits from several starts; the best one wins.

    The landscape has local minima and flat valleys: from one random start 2 to 5 fits of 8 find the
    best minimum. The first start is the caller's; the others take discount factors from a
    low-discrepancy sequence over `gamma_range` (within that of `Free`), and other parameters from
    the caller and from the best fit before them in turn. Starts are spared once a fit explains the
    observations to within their noise.
    """

    count: int = 8
    gamma_range: tuple[float, float] = (0.3, 1.0)

    def spread(
        self,
        values: Float[np.ndarray, "p"],
        open_gammas: Bool[np.ndarray, "p"],
        limits: tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p"]],
    ) -> Float[np.ndarray, "S p"]:
        """Starting vectors, the caller's first; just that one when no discount factor is free."""
        where = np.flatnonzero(open_gammas)
        if self.count < 2 or where.size == 0:
            return values[None]
        points = qmc.Halton(where.size, scramble=False).random(self.count)[1:]
        least, most = (limit[where] for limit in limits)
        low, high = np.maximum(self.gamma_range[0], least), np.minimum(self.gamma_range[1], most)
        apart = low >= high  # where the two ranges have nothing in common, the limits count
        low, high = np.where(apart, least, low), np.where(apart, most, high)
        starts = np.tile(values, (self.count, 1))
        starts[1:, where] = low + (high - low) * points
        return starts


UNDETERMINED_GAMMA = 0.29
"""Data-only deviation above which a discount factor counts as open: that of a uniform guess on
[0, 1] (1 / sqrt(12))."""


def is_determined(coordinates: Coordinates, information: Array, values: Array) -> Array:
    """(p,) which parameters the data alone pin down.

    From the data's information matrix (no prior) each parameter's marginal deviation is computed; a
    discount factor counts as determined below `UNDETERMINED_GAMMA`, any other parameter below
    `max(1, |value|)` in its own unit.
    """
    scale = jnp.maximum(jnp.abs(values), 1.0)
    limit = jnp.where(jnp.asarray(coordinates.is_gamma), UNDETERMINED_GAMMA, scale)
    ridge = 1e-6 / limit**2
    deviation = jnp.sqrt(jnp.diag(jnp.linalg.inv(information + jnp.diag(ridge))))
    return deviation < limit


@partial(jax.jit, static_argnums=0)
def _tracked(problem: Problem, data: Data, base: Parameters) -> Iterate:
    return from_controls(problem.layout, problem.options, base, track(problem, data, base))


MOST_STARTS = 16
"""Starts are padded to this many, so that one compiled program serves any number of them."""


@partial(jax.jit, static_argnums=0)
def _run(
    problem: Problem,
    method: GaussNewton | GradientDescent,
    data: Data,
    base: Parameters,
    starts: Float[Array, "S p"],
    count: Int[Array, ""],
    begin: Start,
) -> tuple[Fit, Int[Array, ""], Float[Array, "S"]]:
    """The best local fit of up to `count` starts, one after the other.

    In lockstep (`vmap`) every start would wait for the slowest solve of the slowest fit, and none
    could be spared: the search ends once a fit leaves no more unexplained than the noise would
    (its cost, a chi-squared sum, is at most its expectation), or once the best one has been found
    from two starts and is plausible (three deviations).
    """
    seen = jnp.sum(jnp.any(data.whiten != 0.0, axis=2))
    expected = jnp.maximum(seen - jnp.sum(data.free), 1.0)
    plausible = expected + 3.0 * jnp.sqrt(2.0 * expected)

    def more(state):
        number, best, _, costs = state
        twice = jnp.sum(costs <= best.cost + 0.01) >= 2
        done = (best.cost <= expected) | (twice & (best.cost <= plausible))
        return (number < count) & ~done

    def one(state):
        number, best, solves, costs = state
        # Every other start begins at the best fit's other parameters: where the caller's guess of
        # them is poor, all starts would otherwise fall into the same local minimum.
        fresh = (number % 2 == 1) | (number == 0) | ~jnp.isfinite(best.cost)
        kept = is_gamma | fresh
        values = jnp.where(kept, starts[number], best.values)
        fit, spent = method.run(problem, data, base, values, begin)
        better = fit.cost < best.cost
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), fit, best)
        return number + 1, best, solves + spent, costs.at[number].set(fit.cost)

    is_gamma = jnp.asarray(problem.coordinates.is_gamma)
    nothing = unevaluated(problem, data, base, starts[0], begin)
    zero = jnp.zeros((), int)
    costs = jnp.full(starts.shape[0], jnp.inf)
    _, fit, solves, costs = jax.lax.while_loop(more, one, (zero, nothing, zero, costs))
    return fit, solves, costs


def _inverse_of(information: Array, free: Array, floor: Array) -> Float[Array, "p p"]:
    """Inverse of the free entries' block; 0 elsewhere."""
    reduced = information * free[:, None] * free + jnp.diag(1.0 - free + floor)
    return jnp.linalg.inv(reduced) * free[:, None] * free


@partial(jax.jit, static_argnums=0)
def _finish(problem: Problem, data: Data, base: Parameters, fit: Fit) -> tuple[Any, ...]:
    layout, coordinates = problem.layout, problem.coordinates
    parameters = coordinates.unpack(fit.values, base)
    zero = jnp.zeros(())
    raw = Equilibrium(
        fit.point,
        jnp.zeros_like(fit.point.x),
        fit.error,
        zero,
        zero,
        jnp.zeros((), int),
        fit.success,
    )
    solution = to_solution(layout, raw, parameters)
    seen = fit.residual.shape[0] - data.prior_root.shape[0]
    from_data = fit.jacobian[:seen].T @ fit.jacobian[:seen]
    information = fit.jacobian.T @ fit.jacobian
    floor = 1e-12 * jnp.maximum(jnp.max(jnp.diag(information)), 1e-12)
    held = (fit.values <= data.low) | (fit.values >= data.high)
    free = jnp.where(held, 0.0, data.free)
    # Parameters that rest on a limit do not vary with the others, so they are left out of the
    # inverse; how far the data allow them off that limit is their deviation without it.
    covariance = _inverse_of(information, free, floor)
    loose = jnp.diag(_inverse_of(information, jnp.asarray(data.free), floor))
    covariance += jnp.diag(jnp.where(held, loose, 0.0))
    first = jax.jacfwd(lambda v: coordinates.unpack(v, base).x0)(fit.values)
    rates = jnp.concatenate([first[None], jnp.moveaxis(fit.rates.x, 0, 2)])
    determined = is_determined(coordinates, from_data, fit.values)
    return parameters, solution, covariance, determined, rates


def estimate(
    game: Game,
    observations: Any,
    model: ObservationModel,
    *,
    initial_state: Any,
    theta: Sequence[Theta],
    gamma: Any,
    free: Free | Sequence[Free] = Free(),
    covariance: Any = 1.0,
    prior: Prior = Prior(),
    method: GaussNewton | GradientDescent = GaussNewton(),
    starts: MultiStart = MultiStart(),
    guess: Solution | None = None,
    options: Options = Options(),
) -> Estimate:
    """Estimate what `free` names from noisy, possibly partial observations.

    Args:
        game: the game that is played over the whole horizon T.
        observations: (K, size) of `h(x_1), ..., h(x_K)`, 2 <= K <= T + 1; NaN where missing (an
            agent that is seen late or occluded). Stages after K are predicted.
        model: the observation model `h`.
        initial_state: per-player `x_1`: known, or where to start when free.
        theta: per-player parameters: fixed, or where to start.
        gamma: discount factors: fixed, or where to start; the gamma = 1 baseline fixes them at 1.
        free: what is estimated, for all players or per player.
        covariance: of the noise: a number (variance), (size, size) or (K, size, size).
        prior: beliefs before the data.
        method: `GaussNewton()` (default) or `GradientDescent(rate)`, the paper's Algorithm 1.
        starts: multi-start settings; `MultiStart(1)` uses the caller's start alone.
        guess: solution of a similar game to start from; by default a trajectory that follows the
            observations.
        options: forward-solver settings.

    Returns:
        An `Estimate`; check `status`.

    Raises:
        ValueError: an argument has the wrong shape or value; the message names it.
    """
    layout = layout_of(game)
    parameters = check_parameters(game, initial_state, theta, gamma)
    coordinates, chosen = Coordinates.of(layout, free, parameters)
    if not chosen.any():
        raise ValueError("free: nothing is free; there is nothing to estimate")
    if not 1 <= starts.count <= MOST_STARTS:
        raise ValueError(f"starts.count: is {starts.count}; expected 1 to {MOST_STARTS}")
    values, whiten = check_observations(layout, model, observations, covariance)
    warm = check_guess(layout, guess)
    if not (warm is None or isinstance(warm, Iterate)):
        raise ValueError(f"guess: is a {type(guess).__name__}; expected a Solution")
    with jax.enable_x64(True):
        problem = Problem(layout, coordinates, model, options)
        begin = np.asarray(coordinates.pack(parameters))
        mean, root = prior_terms(prior, coordinates, parameters, chosen)
        limits = coordinates.limits(free, chosen)
        check_start(coordinates, begin, *limits)
        data = Data(values, whiten, mean, root, chosen.astype(float), *limits)
        initial = starts.spread(begin, coordinates.is_gamma & chosen, limits)
        padded = np.pad(initial, ((0, MOST_STARTS - len(initial)), (0, 0)), mode="edge")
        point = _tracked(problem, data, parameters) if warm is None else warm
        start = Start(point, np.asarray(warm is not None))
        fit, count, costs = _run(
            problem, method, data, parameters, padded, np.asarray(len(initial)), start
        )
        found, solution, spread, determined, rates = to_numpy(
            _finish(problem, data, parameters, fit)
        )
        fit, count, costs = to_numpy((fit, count, costs))
    status = solution.status if fit.success else np.asarray(int(Status.ITERATION_LIMIT))
    names = tuple(n for n, is_free in zip(coordinates.names, chosen, strict=True) if is_free)
    return Estimate(
        found.theta,
        found.gamma,
        tuple(found.x0[s] for s in layout.state_slices),
        solution,
        fit.cost,
        names,
        fit.values[chosen],
        spread[np.ix_(chosen, chosen)],
        determined[chosen],
        rates[:, :, chosen],
        status,
        count,
        costs[: len(initial)],
    )
