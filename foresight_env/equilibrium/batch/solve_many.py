"""Many games at once: threads share them and solve theirs in turn or in batch slots."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from foresight_env.annotations import no_type_check
from foresight_env.equilibrium.batch.in_turn import solve_in_turn
from foresight_env.equilibrium.batch.slots import solve_in_slots
from foresight_env.equilibrium.checks.validation import check_kinds, check_parameters
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.equilibrium.solve import Solution, check_iterate
from foresight_env.games.game import Game
from foresight_env.precision import to_double, to_numpy

ACCELERATOR_SLOTS = 4096
"""Games that step together on an accelerator by default: `benchmarks.accelerator` measures games
per second at this and other widths."""


@no_type_check
def solve_many(
    game: Game,
    initial_state: Any,
    theta: Sequence[Mapping[str, Any]] | Sequence[Sequence[Mapping[str, Any]]],
    gamma: Any,
    *,
    initial_guess: Solution | None = None,
    options: SolverOptions = SolverOptions(),
    batch_size: int | None = None,
    threads: int | None = None,
) -> Solution:
    """Solve the same game for many initial states, parameters and discount factors.

    Args:
        game: the game.
        initial_state: (B, n) joint initial states, (B, N, n_i), or per player (B, n_i).
        theta: one mapping per player for all games, or B such sequences.
        gamma: (B, N), or (N,) or a number for all games.
        initial_guess: a `Solution` with a leading axis of B, to start from.
        options: tolerances.
        batch_size: games that step together (batch slots); default one on a processor, where each
            takes its turn (some where stages are large), and thousands on an accelerator.
        threads: threads that each take a share of the games; default one per core, or a single
            one for an accelerator.

    Returns:
        A `Solution` whose arrays have a leading axis of B, each game with its own `status`.

    Raises:
        ValueError: wrong types or shapes, an entry of `theta` that nothing reads, non-finite
            numbers, initial states outside hard bounds; the first wrong game is named. Nothing is
            solved then.
    """
    check_kinds(
        game=(game, Game),
        options=(options, SolverOptions),
        initial_guess=(initial_guess, Solution, type(None)),
    )
    layout = layout_of(game)
    states = _joint_states(layout, initial_state)
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
    starts = None if initial_guess is None else to_double(Iterate(*initial_guess.point))
    if starts is not None:
        check_iterate(layout, starts, (count,))
    return solve_checked(
        layout, parameters, starts, options=options, batch_size=batch_size, threads=threads
    )


def solve_checked(
    layout: Layout,
    parameters: Parameters,
    starts: Iterate | None,
    *,
    options: SolverOptions = SolverOptions(),
    batch_size: int | None = None,
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

    size = default_batch_size() if batch_size is None else batch_size

    def share(worker: int) -> Solution:
        mine = jax.tree.map(lambda v: v[worker::workers], (parameters, starts))
        with jax.enable_x64(True):
            if size == 1:
                found = solve_in_turn(layout, options, *mine, asked[worker])
            else:
                width = min(size, len(mine[0].gamma))
                found = solve_in_slots(layout, options, width, *mine, asked[worker])
            numbers: Solution = to_numpy(found)
        return numbers

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(share, range(workers)))

    def woven(*values: np.ndarray) -> np.ndarray:
        out = np.empty((count, *values[0].shape[1:]), values[0].dtype)
        for worker, value in enumerate(values):
            out[worker::workers] = value
        return out

    woven_: Solution = jax.tree.map(woven, *parts)
    return woven_


def default_batch_size() -> int:
    """Games that step together, depending on what JAX computes on."""
    return 1 if jax.default_backend() == "cpu" else ACCELERATOR_SLOTS


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
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _joint_states(layout: Layout, initial_state: Any) -> Float[np.ndarray, "B n"]:
    sizes = layout.game.state_sizes
    if isinstance(initial_state, (list, tuple)):
        if len(initial_state) != len(sizes):
            raise ValueError(
                f"initial_state: has {len(initial_state)} players; expected {len(sizes)}"
            )
        parts = [np.asarray(v, dtype=float) for v in initial_state]
        for i, (part, size) in enumerate(zip(parts, sizes, strict=True)):
            if part.ndim != 2 or part.shape[1] != size:
                raise ValueError(
                    f"initial_state[{i}]: has shape {part.shape}; expected (B, {size})"
                )
        return np.concatenate(parts, axis=1)
    array = np.asarray(initial_state, dtype=float)
    if array.size == 0:
        raise ValueError("initial_state: is empty; expected at least one game")
    joint = array.reshape(len(array), -1) if array.ndim in (2, 3) else array
    if joint.ndim != 2 or joint.shape[1] != layout.n:
        raise ValueError(
            f"initial_state: has shape {array.shape}; expected (B, {layout.n}) or (B, N, n_i)"
        )
    return joint
