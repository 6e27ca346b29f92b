"""Many games at once: lanes of Newton steps that never wait for a slow neighbour.

Under `vmap` every game runs until the slowest one is done. Here a fixed number of lanes steps
together, and a lane whose game has ended takes the next one that waits.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.implicit import Equilibrium, nudged_start
from foresight_env.equilibrium.interior_point import (
    Evaluation,
    Options,
    converged,
    evaluate,
    hopeless,
    is_finite,
    masks_of,
    newton_step,
    violation,
)
from foresight_env.equilibrium.kkt import Iterate, Parameters
from foresight_env.equilibrium.layout import Layout, layout_of
from foresight_env.equilibrium.solve import Solution, begin, to_solution
from foresight_env.equilibrium.validation import check_parameters
from foresight_env.games.game import Game
from foresight_env.precision import to_numpy

LANES = 16
"""Games that step together. More of them fill a processor's vector units no better and its caches
worse, and leave more lanes idle at the end (`make bench`); a GPU wants thousands."""


class _Lane(NamedTuple):
    """One lane's work; `number` is the game's place in the batch."""

    number: Int[Array, ""]
    attempt: Int[Array, ""]
    iteration: Int[Array, ""]
    spent: Int[Array, ""]
    fresh: Bool[Array, ""]
    """The point has not been evaluated yet."""
    point: Iterate
    evaluation: Evaluation


def _advance(
    layout: Layout, options: Options, parameters: Parameters, starts: Iterate, lane: _Lane
) -> tuple[_Lane, Equilibrium, Bool[Array, ""]]:
    """One step of one lane; its result so far, and whether the game has ended."""
    masks = masks_of(layout)
    count = parameters.gamma.shape[0]
    mine: Parameters = jax.tree.map(lambda v: v[jnp.minimum(lane.number, count - 1)], parameters)
    old = lane.evaluation
    stepped = newton_step(layout, masks, lane.point, old, options)
    point = _choose(lane.fresh, lane.point, stepped)
    exact_below = options.exact_below * 10.0**lane.attempt
    convexity = jnp.where(~lane.fresh & (old.error < exact_below), 0.0, 1.0)
    ev = evaluate(layout, masks, point, mine, convexity, options)
    finite = is_finite(point, ev)
    keep = finite | lane.fresh
    point, ev = _choose(keep, (point, ev), (lane.point, old))
    iteration = lane.iteration + jnp.where(lane.fresh, 0, 1)
    spent = lane.spent + jnp.where(lane.fresh, 0, 1)
    solved = converged(ev, options) & finite
    stuck = ~finite | hopeless(point, ev) | (iteration >= options.max_iterations)
    last = lane.attempt + 1 >= options.attempts
    ended = (lane.number < count) & (solved | (stuck & last))
    result = Equilibrium(
        point,
        ev.q,
        jnp.where(finite, ev.error, jnp.inf),
        ev.complementarity,
        violation(ev),
        spent,
        solved,
    )
    begun: Iterate = jax.tree.map(lambda v: v[jnp.minimum(lane.number, count - 1)], starts)
    again = nudged_start(layout, options, mine, begun.u, lane.attempt + 1)
    retry = stuck & ~solved
    lane = _Lane(
        lane.number,
        jnp.where(retry, lane.attempt + 1, lane.attempt),
        jnp.where(retry, 0, iteration),
        spent,
        retry,
        _choose(retry, again, point),
        ev,
    )
    return lane, result, ended


def _choose(condition: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _solve_lanes(
    layout: Layout, options: Options, width: int, parameters: Parameters, starts: Iterate | None
) -> Solution:
    count = parameters.gamma.shape[0]
    if starts is None:
        starts = jax.vmap(lambda p: begin(layout, options, p, None))(parameters)
    else:
        starts = jax.vmap(lambda p, s: begin(layout, options, p, s))(parameters, starts)
    masks = masks_of(layout)

    def first(point: Iterate, mine: Parameters) -> tuple[_Lane, Equilibrium]:
        ev = evaluate(layout, masks, point, mine, jnp.ones(()), options)
        zero = jnp.zeros((), int)
        lane = _Lane(zero, zero, zero, zero, jnp.ones((), bool), point, ev)
        nothing = Equilibrium(point, ev.q, ev.error, ev.error, ev.error, zero, jnp.zeros((), bool))
        return lane, nothing

    head = jnp.minimum(jnp.arange(width), count - 1)
    lanes, nothing = jax.vmap(first)(*jax.tree.map(lambda v: v[head], (starts, parameters)))
    lanes = lanes._replace(number=jnp.arange(width))
    found = jax.tree.map(lambda v: jnp.zeros((count, *v.shape[1:]), v.dtype), nothing)

    def body(state: tuple[_Lane, Equilibrium, Array]) -> tuple[_Lane, Equilibrium, Array]:
        lanes, found, waiting = state
        lanes, result, ended = jax.vmap(
            partial(_advance, layout, options), in_axes=(None, None, 0)
        )(parameters, starts, lanes)
        # Lanes still at work write beyond the end, which is dropped.
        place = jnp.where(ended, lanes.number, count)
        found = jax.tree.map(lambda all_, v: all_.at[place].set(v, mode="drop"), found, result)
        following = waiting + jnp.cumsum(ended) - 1
        number = jnp.where(ended, jnp.minimum(following, count), lanes.number)
        start = jax.tree.map(lambda v: v[jnp.minimum(number, count - 1)], starts)

        def renew(new: Array, old: Array) -> Array:
            return jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), new, old)

        zero = jnp.zeros_like(lanes.attempt)
        lanes = _Lane(
            number,
            renew(zero, lanes.attempt),
            renew(zero, lanes.iteration),
            renew(zero, lanes.spent),
            lanes.fresh | ended,
            jax.tree.map(renew, start, lanes.point),
            lanes.evaluation,
        )
        return lanes, found, waiting + jnp.sum(ended)

    def busy(state: tuple[_Lane, Equilibrium, Array]) -> Bool[Array, ""]:
        return jnp.any(state[0].number < count)

    begun = (lanes, found, jnp.asarray(min(width, count)))
    _, found, _ = jax.lax.while_loop(busy, body, begun)
    return jax.vmap(partial(to_solution, layout))(found, parameters)


def solve_many(
    game: Game,
    x0: Any,
    theta: Sequence[Mapping[str, Any]] | Sequence[Sequence[Mapping[str, Any]]],
    gamma: Any,
    *,
    guess: Solution | None = None,
    options: Options = Options(),
    lanes: int = LANES,
    threads: int | None = None,
) -> Solution:
    """Solve the same game for many initial states, parameters and discount factors.

    Args:
        game: the game.
        x0: (B, n) joint initial states, (B, N, n_i), or per player (B, n_i).
        theta: one mapping per player for all games, or B such sequences.
        gamma: (B, N), or (N,) or a number for all games.
        guess: a `Solution` with a leading axis of B, to start from.
        options: tolerances.
        lanes: games that step together.
        threads: threads that each take a share of the games; default one per core.

    Returns:
        A `Solution` whose arrays have a leading axis of B, each game with its own `status`.

    Raises:
        ValueError: wrong shapes, non-finite numbers, initial states outside hard bounds; the first
            wrong game is named. Nothing is solved then.
    """
    layout = layout_of(game)
    states = _joint_states(layout, x0)
    count = len(states)
    players = len(game.players)
    gammas = np.asarray(gamma, dtype=float)
    if gammas.shape not in ((), (players,), (count, players)):
        raise ValueError(
            f"gamma: has shape {gammas.shape}; expected ({count}, {players}), ({players},) or a "
            "number"
        )
    gammas = np.broadcast_to(gammas, (count, players))
    parameters = _checked(game, states, theta, gammas)
    starts = None if guess is None else Iterate(*guess.point)
    if starts is not None and starts.x.shape != (count, game.horizon, layout.n):
        raise ValueError(
            f"guess: joint states have shape {starts.x.shape}; expected "
            f"{(count, game.horizon, layout.n)}"
        )
    workers = max(1, min(threads or _cores(), count))

    def share(worker: int) -> Solution:
        mine = jax.tree.map(lambda v: v[worker::workers], (parameters, starts))
        with jax.enable_x64(True):
            found: Solution = to_numpy(
                _solve_lanes(layout, options, min(lanes, len(mine[0].gamma)), *mine)
            )
        return found

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(share, range(workers)))

    def woven(*values: np.ndarray) -> np.ndarray:
        out = np.empty((count, *values[0].shape[1:]), values[0].dtype)
        for worker, value in enumerate(values):
            out[worker::workers] = value
        return out

    woven_: Solution = jax.tree.map(woven, *parts)
    return woven_


def _checked(game: Game, states: np.ndarray, theta: Any, gammas: np.ndarray) -> Parameters:
    """Parameters of all games; a wrong game is named."""
    count = len(states)
    shared = isinstance(theta[0], Mapping)
    if not shared and len(theta) != count:
        raise ValueError(f"theta: has {len(theta)} entries; expected one per game, {count}")

    def check(k: int) -> Parameters:
        try:
            return check_parameters(game, states[k], theta if shared else theta[k], gammas[k])
        except ValueError as error:
            raise ValueError(f"game {k}: {error}") from error

    # With one theta for all, what can be wrong with a single game is its state and its gamma.
    one = check(0)
    if not shared:
        each = [one.theta, *(check(k).theta for k in range(1, count))]
        thetas = jax.tree.map(lambda *v: np.stack(v), *each)
        return Parameters(states, thetas, gammas)
    layout = layout_of(game)
    low, high = (b[0, : layout.n] for b in layout.bounds)
    least, most = np.array([p.discounting.limits for p in game.players]).T
    fine = ((states >= low) & (states <= high)).all(axis=1)  # NaN fails both comparisons
    fine &= ((gammas >= least) & (gammas <= most)).all(axis=1)
    fine &= np.isfinite(states).all(axis=1) & np.isfinite(gammas).all(axis=1)
    for k in np.flatnonzero(~fine):
        check(int(k))
    thetas = jax.tree.map(lambda v: np.broadcast_to(v, (count, *np.shape(v))), one.theta)
    return Parameters(states, thetas, gammas)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _joint_states(layout: Layout, x0: Any) -> Float[np.ndarray, "B n"]:
    sizes = layout.game.state_sizes
    if isinstance(x0, (list, tuple)):
        if len(x0) != len(sizes):
            raise ValueError(f"x0: has {len(x0)} players; expected {len(sizes)}")
        parts = [np.asarray(v, dtype=float) for v in x0]
        for i, (part, size) in enumerate(zip(parts, sizes, strict=True)):
            if part.ndim != 2 or part.shape[1] != size:
                raise ValueError(f"x0[{i}]: has shape {part.shape}; expected (B, {size})")
        return np.concatenate(parts, axis=1)
    array = np.asarray(x0, dtype=float)
    if array.size == 0:
        raise ValueError("x0: is empty; expected at least one game")
    joint = array.reshape(len(array), -1) if array.ndim in (2, 3) else array
    if joint.ndim != 2 or joint.shape[1] != layout.n:
        raise ValueError(f"x0: has shape {array.shape}; expected (B, {layout.n}) or (B, N, n_i)")
    return joint
