"""The forward problem: from a game and its parameters to an equilibrium.

The generalised open-loop Nash equilibrium (paper, eq. 4) is found as a solution of the players'
joint first-order conditions; `verify` checks whether it is a local equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache, partial
from itertools import accumulate
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from foresight_env.annotations import no_type_check
from foresight_env.compilation import compiled
from foresight_env.equilibrium.checks.diagnosis import check_start_is_finite
from foresight_env.equilibrium.checks.validation import BOUND_SLACK, check_kinds, check_parameters
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import largest_multiplier
from foresight_env.equilibrium.newton.implicit import Equilibrium, equilibrium
from foresight_env.equilibrium.newton.schedule import Limits, limits_of
from foresight_env.equilibrium.newton.start import Start, begin, from_controls
from foresight_env.equilibrium.settings import Budget, SolverOptions
from foresight_env.equilibrium.status import SolveError, Status
from foresight_env.games.game import Game
from foresight_env.games.types import AnyArray, Scalar, Theta
from foresight_env.precision import call_in_double, is_traced, to_double


class Solution(NamedTuple):
    """Equilibrium and solver status; check `status` before use."""

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
    """Newton steps, all phases together."""
    margin: Float[AnyArray, ""]
    """Strict-complementarity margin, `min max(slack, multiplier)` over all inequalities. Below
    about 1e-3 the active set is about to change and derivatives are those of the smoothed
    problem."""
    point: Iterate
    """Multipliers and slacks, for warm starts."""

    def __repr__(self) -> str:
        shapes = ", ".join(str(np.shape(s)) for s in self.states)
        if is_traced(self):
            return f"Solution(traced, states: {shapes})"
        if np.ndim(self.status):
            solved = int(np.sum(np.asarray(self.status) == Status.SOLVED))
            return f"Solution({solved} of {np.size(self.status)} solved, states: {shapes})"
        return (
            f"Solution({Status(int(self.status)).name}, residual={float(self.residual):.1e}, "
            f"iterations={int(self.iterations)}, states: {shapes})"
        )


WEAK_COMPLEMENTARITY = 1e-3
"""Margin (smaller of slack and multiplier, at the pair where it is least) below which derivatives
are smoothed across a change of the active set: `benchmarks.derivatives` compares both sides of it
with finite differences."""


def complementarity_margin(layout: Layout, point: Iterate) -> Scalar:
    """`min max(slack, multiplier)` over all pairs."""
    larger = jnp.maximum(point.slack, point.mult)
    return jnp.min(jnp.where(pairs_of(layout).exists, larger, jnp.inf), initial=jnp.inf)


def _status(
    layout: Layout, options: SolverOptions, raw: Equilibrium, parameters: Parameters
) -> Int[Array, ""]:
    n = layout.n
    low, high = layout.bounds
    state = parameters.initial_state
    outside = jnp.any(state < low[0, :n] - BOUND_SLACK) | jnp.any(state > high[0, :n] + BOUND_SLACK)
    finite = jnp.stack([jnp.all(jnp.isfinite(v)) for v in jax.tree.leaves(parameters)]).all()
    least, most = np.array([p.discounting.limits for p in layout.game.players]).T
    outside |= jnp.any(parameters.gamma < least) | jnp.any(parameters.gamma > most)
    # Infeasibility comes first: it is what makes multipliers grow, in the end until they overflow.
    large = largest_multiplier(layout, raw.point) > options.infeasible_multiplier
    failed = jnp.where(
        (raw.violation > options.violated) & large,
        Status.INFEASIBLE,
        jnp.where(jnp.isfinite(raw.error), Status.ITERATION_LIMIT, Status.DIVERGED),
    )
    outcome = jnp.where(raw.success, Status.SOLVED, failed)
    return jnp.where(outside | ~finite, Status.INVALID_INPUT, outcome)


def to_solution(
    layout: Layout, options: SolverOptions, raw: Equilibrium, parameters: Parameters
) -> Solution:
    """Joint arrays to per-player ones, with status and margin."""
    states = jnp.concatenate([parameters.initial_state[None], raw.point.x])
    return Solution(
        tuple(states[:, s] for s in layout.state_slices),
        tuple(raw.point.u[:, s] for s in layout.control_slices),
        _status(layout, options, raw, parameters),
        jnp.maximum(raw.error, raw.complementarity),
        raw.iterations,
        complementarity_margin(layout, raw.point),
        raw.point,
    )


class StartKind(IntEnum):
    """Kind of start of a concrete call; one compiled program serves all of them."""

    COLD = 0
    CONTROLS = 1
    SOLUTION = 2


@compiled(static_argnums=(0, 1))
def _solve_packed(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    point: Iterate,
    kind: Array,
    limits: Limits,
) -> Float[Array, "packed"]:
    """All of a `Solution` in one vector, which is handed over ten times as fast as its arrays.

    And, before its status, whether the solve could begin.
    """

    def cold() -> Iterate:
        return from_controls(layout, options, parameters, jnp.zeros_like(point.u))

    def controls() -> Iterate:
        return from_controls(layout, options, parameters, point.u)

    first = jax.lax.switch(kind, (cold, controls, lambda: point))
    start = Start(first, kind == StartKind.SOLUTION, limits=limits)
    raw = equilibrium(layout, options, parameters, start)
    found = to_solution(layout, options, raw, parameters)
    states = jnp.concatenate(found.states, axis=1)
    numbers = [jnp.asarray(v, float) for v in (raw.began, found.status, found.iterations)]
    parts = (states, *found.point[1:], *numbers, found.residual, found.margin)
    return jnp.concatenate([jnp.ravel(v) for v in parts])


NUMBERS = 5
"""Scalars at the end of what is packed."""


def _unpack(layout: Layout, packed: Any) -> Solution:
    horizon = layout.game.horizon
    sizes = (layout.n, layout.m, layout.pair_count, layout.pair_count)
    widths = [horizon * size for size in sizes]
    widths[0] += layout.n
    ends = list(accumulate(widths))
    states, u, slack, mult = (
        packed[end - width : end].reshape(-1, size)
        for end, width, size in zip(ends, widths, sizes, strict=True)
    )
    status, iterations, residual, margin = packed[ends[-1] + 1 :, None]
    return Solution(
        tuple(states[:, s] for s in layout.state_slices),
        tuple(u[:, s] for s in layout.control_slices),
        status.astype(int).reshape(()),
        residual.reshape(()),
        iterations.astype(int).reshape(()),
        margin.reshape(()),
        Iterate(states[1:], u, slack, mult),
    )


@lru_cache(maxsize=256)
def blank_point(layout: Layout) -> Iterate:
    """Return zeros of an iterate's shapes, where a point is not read or not known yet."""
    sizes = (layout.n, layout.m, layout.pair_count, layout.pair_count)
    blank: list[Any] = [np.zeros((layout.game.horizon, size)) for size in sizes]
    return Iterate(*blank)


def _solve_concrete(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    initial_guess: Iterate | AnyArray | None,
    budget: Budget,
) -> Solution:
    kind, point = StartKind.COLD, blank_point(layout)
    if isinstance(initial_guess, Iterate):
        kind, point = StartKind.SOLUTION, to_double(initial_guess)
    elif initial_guess is not None:
        controls: Any = np.asarray(initial_guess, dtype=float)
        kind, point = StartKind.CONTROLS, point._replace(u=controls)
    how = (np.asarray(int(kind)), limits_of(budget))
    packed = np.asarray(_solve_packed(layout, options, parameters, point, *how))
    if not packed[-NUMBERS]:
        check_start_is_finite(layout, parameters, initial_guess)
    return _unpack(layout, packed)


@partial(jax.jit, static_argnums=(0, 1, 4))
def _solve_traced(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    initial_guess: Iterate | AnyArray | None,
    budget: Budget,
) -> Solution:
    start = begin(layout, options, parameters, initial_guess)
    if budget != Budget.offline():
        start = start._replace(limits=limits_of(budget))
    raw = equilibrium(layout, options, parameters, start)
    return to_solution(layout, options, raw, parameters)


@no_type_check
def shift(solution: Solution) -> Solution:
    """Return the solution one stage later, its last stage repeated: a warm start.

    Args:
        solution: of one game.

    Returns:
        A solution of the same shapes, for `solve(..., initial_guess=...)` in the next step.

    Raises:
        ValueError: it is no `Solution`, or holds several games.
    """
    check_kinds(solution=(solution, Solution))
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


@no_type_check
def solve(
    game: Game,
    initial_state: Any,
    theta: Sequence[Theta],
    gamma: Any,
    *,
    initial_guess: Solution | Sequence[Any] | None = None,
    options: SolverOptions = SolverOptions(),
    budget: Budget = Budget.offline(),
    throw: bool = False,
) -> Solution:
    """Solve `game` for a generalised open-loop Nash equilibrium.

    Args:
        game: the game; equal games share one compiled solver.
        initial_state: per-player initial states, each (n_i,), or an array (N, n).
        theta: one mapping of cost parameters per player.
        gamma: discount factors, (N,) or one number; 0 is myopic, above 1 is allowed.
        initial_guess: a `Solution` of a similar game (warm start; discarded after two failed
            phases), or per-player controls (T, m_i).
        options: tolerances.
        budget: limits of phases and Newton steps, such as `Budget.trial()` where a late solution
            is useless.
        throw: raise `SolveError` when the game was not solved (concrete calls only).

    Returns:
        A `Solution`. Works under `jit`, `vmap` and `grad`; derivatives with respect to
        `initial_state`, `theta` and `gamma` are exact (implicit function theorem) and NaN where the
        solve failed.

    Raises:
        ValueError: wrong types or shapes, an entry of `theta` that nothing reads, non-finite
            numbers, an initial state outside hard bounds, or a function that is not finite where
            the solve starts.
        SolveError: with `throw`, when the status is not `Status.SOLVED`.
    """
    check_kinds(game=(game, Game), options=(options, SolverOptions), budget=(budget, Budget))
    layout = layout_of(game)
    parameters = check_parameters(game, initial_state, theta, gamma)
    start = check_guess(layout, initial_guess)
    if not is_traced(parameters, start):
        with jax.enable_x64(True):
            result = _solve_concrete(layout, options, parameters, start, budget)
        if throw and int(result.status) != Status.SOLVED:
            raise SolveError(Status(int(result.status)), float(result.residual))
        return result
    start = jax.tree.map(jax.lax.stop_gradient, start)
    if jnp.result_type(float) == jnp.float64:  # the caller traces in double precision
        return _solve_traced(layout, options, to_double(parameters), to_double(start), budget)
    return call_in_double(lambda p: _solve_traced(layout, options, *p, budget), (parameters, start))


def check_iterate(layout: Layout, point: Iterate, batch: tuple[int, ...] = ()) -> None:
    """Raise `ValueError` where an initial guess solves a game of other sizes."""
    sizes = (layout.n, layout.m, layout.pair_count, layout.pair_count)
    names = ("joint states", "joint controls", "slacks", "multipliers")
    for name, value, size in zip(names, point, sizes, strict=True):
        expected = (*batch, layout.game.horizon, size)
        if value.shape != expected:
            raise ValueError(
                f"initial_guess: solves another game: {name} have shape {value.shape}; expected "
                f"{expected}"
            )


def check_guess(layout: Layout, initial_guess: Any) -> Iterate | AnyArray | None:
    """An initial guess as joint arrays: an iterate, or controls (T, m)."""
    horizon = layout.game.horizon
    if initial_guess is None:
        return None
    if isinstance(initial_guess, Solution):
        point = Iterate(*initial_guess.point)
        check_iterate(layout, point)
        return point
    shapes = tuple((horizon, m) for m in layout.game.control_sizes)
    if not isinstance(initial_guess, Sequence) and not np.ndim(initial_guess):
        raise ValueError(
            f"initial_guess: is {initial_guess!r}; expected a Solution, or controls of shapes "
            f"{shapes}"
        )
    given = tuple(np.shape(c) for c in initial_guess)
    if given != shapes:
        raise ValueError(f"initial_guess: controls of shapes {given}; expected {shapes}")
    xp: Any = jnp if is_traced(initial_guess) else np
    return xp.concatenate([xp.asarray(c) for c in initial_guess], axis=1)
