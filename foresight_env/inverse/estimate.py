"""Inverse problem: discount factors and cost parameters from observations, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foresight_env.compilation import compiled, compiling, first_time, signature
from foresight_env.equilibrium.checks.validation import check_kinds, check_parameters
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.equilibrium.newton.implicit import Equilibrium
from foresight_env.equilibrium.newton.schedule import limits_of
from foresight_env.equilibrium.newton.start import Start, from_controls
from foresight_env.equilibrium.settings import Budget, SolverOptions
from foresight_env.equilibrium.solve import Solution, blank_point, check_guess, to_solution
from foresight_env.equilibrium.status import Status
from foresight_env.games.game import Game
from foresight_env.games.observations import ObservationModel
from foresight_env.games.types import Theta
from foresight_env.inverse.coordinates import Coordinates, Free
from foresight_env.inverse.fit import Data, Fit, Problem
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent
from foresight_env.inverse.laplace import (
    OPEN_GAMMA_DEVIATION,
    laplace,
    laplace_intervals,
)
from foresight_env.inverse.linear_step import Rates, linear_step
from foresight_env.inverse.multi_start import MOST_STARTS, MultiStart, search
from foresight_env.inverse.posterior import Posterior, Search, sampled
from foresight_env.inverse.prior import Prior, prior_terms
from foresight_env.inverse.profile import Profile, profiled
from foresight_env.inverse.result import Estimate
from foresight_env.inverse.settings import EstimatorSettings
from foresight_env.inverse.tracking import track
from foresight_env.inverse.tracking_term import (
    has_tracking_cost,
    tracking_precision,
    with_tracking,
    with_tracking_cost,
    without_tracking,
)
from foresight_env.inverse.validation import (
    check_information,
    check_observations,
    check_rates,
    check_start,
)
from foresight_env.precision import to_numpy


@compiled(static_argnums=0)
def _tracked(problem: Problem, data: Data, base: Parameters) -> tuple[Iterate, Array]:
    """The start that follows the observations, and the tracking term's precisions about it."""
    layout = problem.layout
    point = from_controls(layout, problem.options, base, track(problem, data, base))
    if not has_tracking_cost(layout):
        return point, jnp.zeros_like(point.x)
    return point, tracking_precision(layout, problem.model, data.whiten, base, point)


def _with_target(layout: Layout, parameters: Parameters, warm: Iterate | None) -> Parameters:
    """Parameters with a tracking term of precision 0 about a guess, where the game has one."""
    if not has_tracking_cost(layout):
        return parameters
    nothing = np.zeros((layout.game.horizon, layout.n))
    return with_tracking(layout, parameters, nothing if warm is None else warm.x, nothing)


@compiled(static_argnums=0, optimised=False)
def _finish(problem: Problem, data: Data, base: Parameters, fit: Fit) -> tuple[Any, ...]:
    layout, coordinates = problem.layout, problem.coordinates
    parameters = coordinates.unpack(fit.values, base)
    raw = Equilibrium(
        fit.point,
        jnp.zeros_like(fit.point.x),
        fit.error,
        fit.complementarity,
        jnp.zeros(()),
        fit.newton_steps,
        fit.success,
    )
    solution = to_solution(layout, problem.options, raw, parameters)
    covariance, identifiable = laplace(problem, data, fit)
    first = jax.jacfwd(lambda v: coordinates.unpack(v, base).initial_state)(fit.values)
    rates = jnp.concatenate([first[None], jnp.moveaxis(fit.rates.x, 0, 2)])
    return parameters, solution, covariance, identifiable, rates


def _compile_together(
    problem: Problem,
    method: GaussNewton | GradientDescent,
    data: Data,
    base: Parameters,
    starts: Float[np.ndarray, "S p"],
    count: Int[np.ndarray, ""],
    start: Start,
    cold: bool,
) -> None:
    """Compile what an estimate calls: `search`, by far the largest, while the others compile.

    Only `search` has a second thread: tracing holds Python's lock. It is traced first, since all
    else is compiled before it is ready.
    """
    traced = search.trace(problem, method, data, base, starts, count, start)
    with compiling(traced.lower()):
        if cold:
            _tracked.lower(problem, data, base).compile()
        _finish.lower(problem, data, base, traced.out_info[0]).compile()


def _stepped(
    problem: Problem,
    data: Data,
    base: Parameters,
    values: Float[np.ndarray, "p"],
    point: Iterate,
    rates: Rates,
    chosen: Bool[np.ndarray, "p"],
) -> Float[np.ndarray, "p"]:
    states = np.zeros((*rates.states.shape[:2], chosen.size))
    states[:, :, chosen] = rates.states
    carry = np.eye(chosen.size)
    carry[np.ix_(chosen, chosen)] = rates.carry
    return np.asarray(linear_step(problem, data, base, values, point, states, carry))


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
    profile: Profile | None = None,
    posterior: Posterior | None = None,
    initial_guess: Solution | None = None,
    initial_guess_rates: Rates | None = None,
    budget: Budget = Budget.offline(),
    options: SolverOptions = SolverOptions(),
    settings: EstimatorSettings = EstimatorSettings(),
) -> Estimate:
    """Estimate what `free` names from noisy, possibly partial observations.

    Args:
        game: the game that is played over the whole horizon T.
        observations: (K, size) of `h(x_1), ..., h(x_K)`, 2 <= K <= T + 1; NaN where missing (an
            agent that is observed late or occluded). Stages after K are predicted.
        model: the observation model `h`.
        initial_state: per-player `x_1`: known, or where to start when free.
        theta: per-player parameters: fixed, or where to start.
        gamma: discount factors: fixed, or where to start; the gamma = 1 baseline fixes them at 1.
        free: what is estimated, for all players or per player.
        covariance: of the noise: a number (variance), (size, size) or (K, size, size).
        prior: prior of the parameters.
        method: `GaussNewton()` (default) or `GradientDescent(rate)`, the paper's Algorithm 1.
        starts: multi-start settings; `MultiStart(1)` uses the caller's start alone.
        profile: find intervals of the discount factors by profile likelihood (always by
            Gauss-Newton), typically at two to six times the forward solves of the estimate alone
            and more where better fits are met on the way, which replace it.
        posterior: average over the posterior, `Estimate.mean`; `solution` and parameters are then
            those of the sampled equilibrium nearest to the mean trajectory, and intervals of the
            discount factors are the posterior's. Not together with a profile.
        initial_guess: solution of a similar game to start from; by default a trajectory that
            follows the observations.
        initial_guess_rates: how `initial_guess` changes with the free parameters; the search then
            begins where a step on them leads, before any game is solved.
        budget: limits of the forward solves' phases and Newton steps.
        options: forward-solver settings.
        settings: settings of the search beyond the method's.

    Returns:
        An `Estimate`; check `status`.

    Raises:
        NeverSeenError: an agent whose initial state is free was never observed.
        ValueError: an argument has the wrong shape or value; the message names it.
    """
    check_kinds(
        model=(model, ObservationModel),
        free=(free, Free, tuple, list),
        method=(method, GaussNewton, GradientDescent),
        starts=(starts, MultiStart),
        profile=(profile, Profile, type(None)),
        posterior=(posterior, Posterior, type(None)),
        budget=(budget, Budget),
        options=(options, SolverOptions),
        settings=(settings, EstimatorSettings),
    )
    if profile is not None and posterior is not None:
        raise ValueError("posterior: is given with a profile; expected one of both")
    tracked = isinstance(method, GaussNewton) and len(method.tracking_weights) > 0
    layout = layout_of(with_tracking_cost(game) if tracked else game)
    parameters = check_parameters(game, initial_state, theta, gamma, "initial_state")
    coordinates, chosen = Coordinates.of(layout, free, parameters)
    if not chosen.any():
        raise ValueError("free: nothing is free; there is nothing to estimate")
    if not 1 <= starts.count <= MOST_STARTS:
        raise ValueError(f"starts.count: is {starts.count}; expected 1 to {MOST_STARTS}")
    values, whiten = check_observations(layout, model, observations, covariance)
    warm = check_guess(layout, initial_guess)
    if not (warm is None or isinstance(warm, Iterate)):
        raise ValueError(f"initial_guess: is a {type(initial_guess).__name__}; expected a Solution")
    check_rates(layout, initial_guess_rates, warm is not None, int(chosen.sum()))
    with jax.enable_x64(True):
        problem = Problem(layout, coordinates, model, options, settings)
        begin = np.asarray(coordinates.pack(parameters))
        mean, root = prior_terms(prior, coordinates, parameters, chosen)
        believed = np.any(root != 0.0, axis=0)
        check_information(model, observations, coordinates, chosen, believed)
        limits = coordinates.limits(free, chosen)
        check_start(coordinates, begin, *limits)
        data = Data(values, whiten, mean, root, chosen.astype(float), *limits)
        if initial_guess_rates is not None and isinstance(warm, Iterate):
            begin = _stepped(problem, data, parameters, begin, warm, initial_guess_rates, chosen)
        initial = starts.spread(begin, coordinates.is_gamma & chosen, limits)
        padded = np.pad(initial, ((0, MOST_STARTS - len(initial)), (0, 0)), mode="edge")
        granted, cold = limits_of(budget), warm is None
        # The tracking term's target and precision: of the start, which is not there yet.
        parameters = _with_target(layout, parameters, warm)
        point = blank_point(layout) if warm is None else warm
        start = Start(point, np.asarray(not cold), limits=granted)
        count_of = np.asarray(len(initial))
        known = (method, data, parameters, padded, count_of)
        with first_time((problem, signature((*known, start)), cold)) as new:
            if new:
                _compile_together(problem, *known, start, cold)
        if cold:
            point, precision = _tracked(problem, data, parameters)
            start = start._replace(point=point)
            if has_tracking_cost(layout):
                parameters = with_tracking(layout, parameters, point.x, precision)
        fit, count, costs = search(problem, method, data, parameters, padded, count_of, start)
        intervals = None
        if profile is not None and bool(fit.success):
            local = method if isinstance(method, GaussNewton) else GaussNewton()
            fit, intervals, more = profiled(problem, data, parameters, fit, local, profile, granted)
            count = count + more
        average = None
        if posterior is not None and bool(fit.success):
            local = method if isinstance(method, GaussNewton) else GaussNewton()
            how = Search(local, start, begin)
            average = sampled(problem, data, parameters, fit, how, posterior)
            fit, intervals, count = average.nearest, average.intervals, count + average.solves
        found, solution, spread, identifiable, rates = to_numpy(
            _finish(problem, data, parameters, fit)
        )
        fit, count, costs = to_numpy((fit, count, costs))
    at = np.flatnonzero(coordinates.is_gamma)
    if average is not None:
        spread, identifiable = average.covariance, average.identifiable
    asked = profile if posterior is None else posterior
    if intervals is None or asked is None:
        intervals = laplace_intervals(fit.values[at], spread[at, at], limits[0][at], limits[1][at])
    else:
        # A narrow interval speaks for the data unless the prior alone would make it narrow.
        firm = np.sum(root[:, at] ** 2, axis=0) > OPEN_GAMMA_DEVIATION**-2
        narrow = np.diff(intervals)[:, 0] < asked.level * (limits[1] - limits[0])[at]
        identifiable = identifiable.copy()
        identifiable[at] = np.where(firm, identifiable[at], narrow)
    status = solution.status if fit.success else np.asarray(int(Status.ITERATION_LIMIT))
    free_ones = tuple(
        p for p, is_free in zip(coordinates.parameters, chosen, strict=True) if is_free
    )
    return Estimate(
        without_tracking(found.theta),
        found.gamma,
        tuple(found.initial_state[s] for s in layout.state_slices),
        solution,
        fit.cost,
        free_ones,
        fit.values[chosen],
        spread[np.ix_(chosen, chosen)],
        identifiable[chosen],
        rates[:, :, chosen],
        status,
        count,
        fit.newton_steps,
        costs[: len(initial)],
        intervals,
        None if average is None else average.mean._replace(values=average.mean.values[chosen]),
    )
