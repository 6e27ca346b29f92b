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

from foresight_env.equilibrium.attempts import attempt_count, attempt_rules
from foresight_env.equilibrium.convexity import next_convexity, used_convexity
from foresight_env.equilibrium.implicit import Equilibrium
from foresight_env.equilibrium.interior_point import (
    Options,
    accuracy_of,
    astray,
    converged,
    hopeless,
    is_finite,
    newton_step,
)
from foresight_env.equilibrium.kkt import Iterate, Parameters
from foresight_env.equilibrium.layout import Layout, layout_of
from foresight_env.equilibrium.pairs import pairs_of
from foresight_env.equilibrium.residual import evaluate, violation
from foresight_env.equilibrium.solve import Solution, check_iterate, to_solution
from foresight_env.equilibrium.start import Start, begin, begin_attempt
from foresight_env.equilibrium.validation import check_parameters
from foresight_env.games.game import Game
from foresight_env.games.types import AnyArray
from foresight_env.precision import to_double, to_numpy

LANES = 16
"""Games that step together. More of them fill a processor's vector units no better and its caches
worse, and leave more lanes idle at the end (`make bench`); a GPU wants thousands."""


class _Lane(NamedTuple):
    """One lane's work; `number` is the game's place in the batch."""

    number: Int[Array, ""]
    attempt: Int[Array, ""]
    iteration: Int[Array, ""]
    spent: Int[Array, ""]
    error: Float[Array, ""]
    """That of the point before; infinite at an attempt's start."""
    begun: Float[Array, ""]
    """That of the attempt's first point, once it is known."""
    convexity: Float[Array, ""]
    taken: Float[Array, ""]
    """The part of the last step; none at an attempt's start."""
    point: Iterate
    safe: Iterate
    """The last point at which everything was finite."""
    broken: Bool[Array, ""]
    """A step overflowed: `point` is the safe one again, and the attempt ends."""


def _fresh(number: Array, attempt: Array, spent: Array, point: Iterate) -> _Lane:
    zero, nothing = jnp.zeros((), int), jnp.zeros(())
    large, never = jnp.asarray(jnp.inf), jnp.zeros((), bool)
    return _Lane(
        number, attempt, zero, spent, large, large, jnp.ones(()), nothing, point, point, never
    )


def _advance(
    layout: Layout, options: Options, mine: Parameters, lane: _Lane, *, cold: bool
) -> tuple[_Lane, Equilibrium, Bool[Array, ""], Bool[Array, ""]]:
    """One step of one lane; its result so far, whether it is solved, whether it is stuck."""
    pairs, accuracy = pairs_of(layout), accuracy_of(options, None)
    local = None if cold else lane.attempt == 0
    near = None if cold else jnp.ones((), bool)
    exact_below, limit = attempt_rules(layout, options, lane.attempt, near)
    if local is not None:
        exact_below = jnp.where(local, jnp.inf, exact_below)
        limit = jnp.where(local, options.local_steps, limit)
    used = used_convexity(lane.convexity, lane.error, exact_below)
    ev = evaluate(layout, pairs, lane.point, mine, used, accuracy.barrier)
    convexity = next_convexity(layout, lane.convexity, lane.error, ev.error, lane.taken)
    finite = is_finite(lane.point, ev)
    solved = converged(ev, accuracy) & finite & ~lane.broken
    begun = jnp.where(lane.iteration == 0, ev.error, lane.begun)
    done = hopeless(layout, lane.point, ev) | (lane.iteration >= limit)
    done |= astray(local, lane.iteration, ev.error, begun)
    # A lane that broke ends its attempt even where its start was not finite either.
    stuck = lane.broken | (finite & ~solved & done)
    result = Equilibrium(
        lane.point,
        ev.q,
        jnp.where(lane.broken, jnp.inf, ev.error),
        ev.complementarity,
        violation(ev),
        lane.spent,
        solved,
    )
    used = used_convexity(convexity, ev.error, exact_below)
    stepped, taken = newton_step(layout, pairs, lane.point, ev, accuracy.barrier, local, used)
    lane = lane._replace(
        iteration=lane.iteration + 1,
        spent=lane.spent + finite,
        error=ev.error,
        begun=begun,
        convexity=convexity,
        taken=taken,
        point=_choose(finite, stepped, lane.safe),
        safe=_choose(finite, lane.point, lane.safe),
        broken=~finite,
    )
    return lane, result, solved, stuck


def _choose(condition: Array, yes: Any, no: Any) -> Any:
    """Entry by entry of the leading axes that `condition` has."""

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(
            condition.reshape(condition.shape + (1,) * (a.ndim - condition.ndim)), a, b
        )

    return jax.tree.map(choose, yes, no)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _solve_lanes(
    layout: Layout,
    options: Options,
    width: int,
    parameters: Parameters,
    guess: Iterate | None,
    active: Int[AnyArray, ""],
) -> Solution:
    count = parameters.gamma.shape[0]
    starts: Start = jax.vmap(lambda p, s: begin(layout, options, p, s))(parameters, guess)
    first = 1 if starts.near is None else 0
    attempts = attempt_count(options, None if starts.near is None else starts.near[0])

    def of(tree: Any, number: Array) -> Any:
        """Entries of these games; lanes without one get the last game's."""
        return jax.tree.map(lambda v: v[jnp.minimum(number, count - 1)], tree)

    def attempt(lanes: _Lane) -> Iterate:
        again = jax.vmap(partial(begin_attempt, layout, options))
        return again(of(parameters, lanes.number), of(starts, lanes.number), lanes.attempt)

    def renewed(lanes: _Lane) -> _Lane:
        """The lanes at the start of their game's attempt."""
        return jax.vmap(_fresh)(lanes.number, lanes.attempt, lanes.spent, attempt(lanes))

    numbers, zeros = jnp.arange(width), jnp.zeros(width, int)
    begun = of(starts.point, numbers)
    lanes = renewed(jax.vmap(_fresh)(numbers, zeros + first, zeros, begun))
    advance = jax.vmap(partial(_advance, layout, options, cold=starts.near is None))
    shapes = jax.eval_shape(advance, of(parameters, numbers), lanes)[1]
    found = jax.tree.map(lambda v: jnp.zeros((count, *v.shape[1:]), v.dtype), shapes)

    def body(state: tuple[_Lane, Equilibrium, Array]) -> tuple[_Lane, Equilibrium, Array]:
        lanes, found, waiting = state
        lanes, result, solved, stuck = advance(of(parameters, lanes.number), lanes)
        ended = solved | (stuck & (lanes.attempt >= attempts))
        ended &= lanes.number < active
        # Lanes still at work write beyond the end, which is dropped.
        place = jnp.where(ended, lanes.number, count)
        found = jax.tree.map(lambda all_, v: all_.at[place].set(v, mode="drop"), found, result)
        following = jnp.minimum(waiting + jnp.cumsum(ended) - 1, count)
        turned = lanes._replace(
            number=jnp.where(ended, following, lanes.number),
            attempt=jnp.where(ended, first, lanes.attempt + 1),
            spent=jnp.where(ended, 0, result.iterations),
        )
        turning = ended | stuck
        lanes = jax.lax.cond(
            jnp.any(turning), lambda: _choose(turning, renewed(turned), lanes), lambda: lanes
        )
        return lanes, found, waiting + jnp.sum(ended)

    def busy(state: tuple[_Lane, Equilibrium, Array]) -> Bool[Array, ""]:
        return jnp.any(state[0].number < active)

    state = (lanes, found, jnp.asarray(min(width, count)))
    _, found, _ = jax.lax.while_loop(busy, body, state)
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
    starts = None if guess is None else to_double(Iterate(*guess.point))
    if starts is not None:
        check_iterate(layout, starts, (count,))
    return solve_checked(layout, parameters, starts, options=options, lanes=lanes, threads=threads)


def solve_checked(
    layout: Layout,
    parameters: Parameters,
    starts: Iterate | None,
    *,
    options: Options = Options(),
    lanes: int = LANES,
    threads: int | None = None,
    active: int | None = None,
) -> Solution:
    """`solve_many` for parameters and starts that are known to be right: float64, leading axis B.

    For callers that solve the same games step after step: checking them one by one would take
    longer than solving them. `active`: only so many games from the first on are solved, and the
    others' rows mean nothing; so batches of different sizes share a compiled program.
    """
    count = len(parameters.gamma)
    workers = max(1, min(threads or _cores(), count))
    # Worker w has games w, w + workers, and so on.
    asked = [
        max(0, -(-((count if active is None else active) - w) // workers)) for w in range(workers)
    ]

    def share(worker: int) -> Solution:
        mine = jax.tree.map(lambda v: v[worker::workers], (parameters, starts))
        with jax.enable_x64(True):
            found: Solution = to_numpy(
                _solve_lanes(layout, options, min(lanes, len(mine[0].gamma)), *mine, asked[worker])
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
