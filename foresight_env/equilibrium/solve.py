"""The forward problem: from a game and its parameters to an equilibrium.

The generalised open-loop Nash equilibrium (paper, eq. 4) is found as a solution of the players'
joint first-order conditions; `verify` tells whether it is a local equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from foresight_env.equilibrium.implicit import Equilibrium, cold_start, equilibrium, rollout
from foresight_env.equilibrium.interior_point import (
    VIOLATED,
    Options,
    largest_multiplier,
    masks_of,
    start_point,
)
from foresight_env.equilibrium.kkt import Iterate, Parameters
from foresight_env.equilibrium.layout import Layout, layout_of
from foresight_env.equilibrium.status import SolveError, Status
from foresight_env.equilibrium.validation import BOUND_SLACK, check_parameters
from foresight_env.games.game import Game
from foresight_env.games.types import AnyArray, Scalar, Theta
from foresight_env.precision import call_in_double, is_traced, to_double, to_numpy


class Solution(NamedTuple):
    """An equilibrium, or an honest failure (`status`)."""

    states: tuple[Float[AnyArray, "stages _"], ...]
    """Per player, `x_1` (given) to `x_{T+1}`."""
    controls: tuple[Float[AnyArray, "T _"], ...]
    """Per player, `u_1` to `u_T`."""
    status: Int[AnyArray, ""]
    """A `Status`; anything but `Status.SOLVED` (0) must not be acted on."""
    residual: Float[AnyArray, ""]
    """Largest entry of the scaled KKT residual: stationarity in current value, dynamics,
    constraints, and complementarity products."""
    iterations: Int[AnyArray, ""]
    """Newton steps, all attempts together."""
    margin: Float[AnyArray, ""]
    """Strict-complementarity margin, `min max(slack, multiplier)` over all inequalities. Below
    about 1e-3 the active set is about to change and derivatives are those of the smoothed
    problem."""
    point: Iterate
    """Multipliers and slacks, for warm starts."""


WEAK_COMPLEMENTARITY = 1e-3
"""Margin below which derivatives are smoothed across a change of the active set."""


def complementarity_margin(layout: Layout, point: Iterate, penalty: Float[AnyArray, "K"]) -> Scalar:
    """`min max(slack, multiplier)` over bounds and rows, both sides of elastic ones."""
    masks = masks_of(layout)
    pairs = (
        (masks.low, point.slack_low, point.mult_low),
        (masks.high, point.slack_high, point.mult_high),
        (jnp.broadcast_to(masks.inequality, point.slack.shape), point.slack, point.mult),
        (jnp.broadcast_to(masks.elastic, point.slack.shape), point.excess, penalty - point.mult),
    )
    each = [
        jnp.min(jnp.where(mask > 0, jnp.maximum(slack, mult), jnp.inf), initial=jnp.inf)
        for mask, slack, mult in pairs
    ]
    return jnp.min(jnp.stack(each))


def _status(layout: Layout, raw: Equilibrium, parameters: Parameters) -> Int[Array, ""]:
    n = layout.n
    low, high = layout.bounds
    state = parameters.x0
    outside = jnp.any(state < low[0, :n] - BOUND_SLACK) | jnp.any(state > high[0, :n] + BOUND_SLACK)
    finite = jnp.stack([jnp.all(jnp.isfinite(v)) for v in jax.tree.leaves(parameters)]).all()
    least, most = np.array([p.discounting.limits for p in layout.game.players]).T
    outside |= jnp.any(parameters.gamma < least) | jnp.any(parameters.gamma > most)
    # Infeasibility comes first: it is what makes multipliers grow, in the end until they overflow.
    failed = jnp.where(
        (raw.violation > VIOLATED) & (largest_multiplier(raw.point) > 1e3),
        Status.INFEASIBLE,
        jnp.where(jnp.isfinite(raw.error), Status.ITERATION_LIMIT, Status.DIVERGED),
    )
    outcome = jnp.where(raw.success, Status.SOLVED, failed)
    return jnp.where(outside | ~finite, Status.INVALID_INPUT, outcome)


def to_solution(layout: Layout, raw: Equilibrium, parameters: Parameters) -> Solution:
    """Joint arrays to per-player ones, with status and margin."""
    states = jnp.concatenate([parameters.x0[None], raw.point.x])
    return Solution(
        tuple(states[:, s] for s in layout.state_slices),
        tuple(raw.point.u[:, s] for s in layout.control_slices),
        _status(layout, raw, parameters),
        jnp.maximum(raw.error, raw.complementarity),
        raw.iterations,
        complementarity_margin(layout, raw.point, layout.penalties(parameters.theta)),
        raw.point,
    )


def begin(
    layout: Layout, options: Options, parameters: Parameters, start: Iterate | AnyArray | None
) -> Iterate:
    """Where a solve starts: cold (None), controls (T, m), or a similar game's iterate (warm)."""
    if start is None:
        return cold_start(layout, options, parameters)
    if isinstance(start, Iterate):
        return warm_start(layout, parameters, start, options)
    controls = jnp.asarray(start)
    states = rollout(layout, parameters.x0, controls)
    return start_point(layout, parameters, states, controls, options)


# Starts are compiled apart from the solve, so that cold and warm ones share its one program.
_begin_jit = jax.jit(begin, static_argnums=(0, 1))


def solve_joint(
    layout: Layout, options: Options, parameters: Parameters, start: Iterate | AnyArray | None
) -> Equilibrium:
    """Solve on joint arrays, double precision taken for granted: the part that others compose."""
    return equilibrium(layout, options, parameters, begin(layout, options, parameters, start))


@partial(jax.jit, static_argnums=(0, 1))
def _solve_jit(
    layout: Layout, options: Options, parameters: Parameters, first: Iterate
) -> Solution:
    return to_solution(layout, equilibrium(layout, options, parameters, first), parameters)


def _solve_from(
    layout: Layout, options: Options, parameters: Parameters, start: Iterate | AnyArray | None
) -> Solution:
    return _solve_jit(layout, options, parameters, _begin_jit(layout, options, parameters, start))


WARM_BARRIER = 1e-4
"""Complementarity product to which a warm start backs off: at the solution's own product the path
is too narrow to follow a change of parameters."""


def warm_start(layout: Layout, parameters: Parameters, point: Iterate, options: Options) -> Iterate:
    """A start near another game's solution: its trajectory and multipliers, off the boundary."""
    near = replace(options, start_barrier=WARM_BARRIER)
    fresh = start_point(layout, parameters, point.x, point.u, near)
    masks = masks_of(layout)
    penalty = layout.penalties(parameters.theta).astype(point.x.dtype)
    floor = np.sqrt(WARM_BARRIER)

    def pair(slack: Array, mult: Array, mask: Array) -> tuple[Array, Array]:
        slack = jnp.where(
            mask > 0, jnp.maximum(slack, WARM_BARRIER / jnp.maximum(mult, floor)), 1.0
        )
        return slack, jnp.where(mask > 0, jnp.maximum(mult, WARM_BARRIER / slack), 0.0)

    slack_low, mult_low = pair(point.slack_low, point.mult_low, masks.low)
    slack_high, mult_high = pair(point.slack_high, point.mult_high, masks.high)
    inequality = jnp.broadcast_to(masks.inequality, point.slack.shape)
    slack, mult = pair(point.slack, point.mult, inequality)
    mult = jnp.where(masks.equality, point.mult, mult)
    capped = jnp.clip(mult, 1e-3 * penalty, (1.0 - 1e-3) * penalty)
    mult = jnp.where(masks.elastic, capped, mult)
    excess = jnp.where(
        masks.elastic,
        jnp.maximum(point.excess, WARM_BARRIER / jnp.where(masks.elastic, penalty - mult, 1.0)),
        0.0,
    )
    return Iterate(
        fresh.x, fresh.u, slack_low, slack_high, mult_low, mult_high, slack, excess, mult
    )


def shift(solution: Solution) -> Solution:
    """The solution one stage later, its last stage repeated: a warm start for the next step."""

    if solution.point.x.ndim != 2:
        raise ValueError(
            f"solution: holds {len(solution.point.x)} games; shift one, or `jax.vmap(shift)` them"
        )
    xp: Any = np if not is_traced(solution) else jnp
    shifted = jax.tree.map(lambda v: xp.concatenate([v[1:], v[-1:]]), solution.point)
    return solution._replace(
        states=tuple(xp.concatenate([v[1:], v[-1:]]) for v in solution.states),
        controls=tuple(xp.concatenate([v[1:], v[-1:]]) for v in solution.controls),
        point=shifted,
    )


def solve(
    game: Game,
    x0: Any,
    theta: Sequence[Theta],
    gamma: Any,
    *,
    guess: Solution | Sequence[Any] | None = None,
    options: Options = Options(),
    throw: bool = False,
) -> Solution:
    """Solve `game` for a generalised open-loop Nash equilibrium.

    Args:
        game: the game; equal games share one compiled solver.
        x0: per-player initial states, each (n_i,), or an array (N, n).
        theta: one mapping of cost parameters per player.
        gamma: discount factors, (N,) or one number; 0 is myopic, above 1 is allowed.
        guess: a `Solution` of a similar game (warm start), or per-player controls (T, m_i).
        options: tolerances.
        throw: raise `SolveError` when the game was not solved (concrete calls only).

    Returns:
        A `Solution`. Works under `jit`, `vmap` and `grad`; derivatives with respect to `x0`,
        `theta` and `gamma` are exact (implicit function theorem) and NaN where the solve failed.

    Raises:
        ValueError: wrong shapes, non-finite numbers, or an initial state outside hard bounds.
        SolveError: with `throw`, when the status is not `Status.SOLVED`.
    """
    layout = layout_of(game)
    parameters = check_parameters(game, x0, theta, gamma)
    start = check_guess(layout, guess)
    if not is_traced(parameters, start):
        with jax.enable_x64(True):
            result: Solution = to_numpy(_solve_from(layout, options, parameters, start))
        if throw and int(result.status) != Status.SOLVED:
            raise SolveError(Status(int(result.status)), float(result.residual))
        return result
    start = jax.tree.map(jax.lax.stop_gradient, start)
    if jnp.result_type(float) == jnp.float64:  # the caller traces in double precision
        return _solve_from(layout, options, to_double(parameters), to_double(start))
    return call_in_double(lambda p: _solve_from(layout, options, *p), (parameters, start))


def check_guess(layout: Layout, guess: Any) -> Iterate | AnyArray | None:
    """A guess as joint arrays: an iterate, or controls (T, m)."""
    horizon = layout.game.horizon
    if guess is None:
        return None
    if isinstance(guess, Solution):
        if guess.point.x.shape != (horizon, layout.n):
            raise ValueError(
                f"guess: solves a game with joint states of shape {guess.point.x.shape}; "
                f"expected {(horizon, layout.n)}"
            )
        return Iterate(*guess.point)
    shapes = tuple((horizon, m) for m in layout.game.control_sizes)
    if tuple(np.shape(c) for c in guess) != shapes:
        raise ValueError(
            f"guess: controls of shapes {tuple(np.shape(c) for c in guess)}; expected {shapes}"
        )
    xp: Any = jnp if is_traced(guess) else np
    return xp.concatenate([xp.asarray(c) for c in guess], axis=1)
