"""Checks of a solver's arguments, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foresight_env.equilibrium.checks.named import Part, parts_of
from foresight_env.equilibrium.checks.theta_entries import (
    abstract_value,
    check_entries_are_read,
)
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.games.game import Game
from foresight_env.games.types import Theta
from foresight_env.precision import is_traced

BOUND_SLACK = 1e-6
"""How far an initial state may lie outside a hard bound, in the bound's own unit: solutions meet
bounds to `SolverOptions.tolerance` only, so this is a hundred times that. A guard, not tuned."""


def check_kinds(**arguments: tuple[Any, ...]) -> None:
    """Each argument's value, then the types that it may have: raises `ValueError` by name."""
    for name, (value, *kinds) in arguments.items():
        if not isinstance(value, tuple(kinds)):
            wanted = " or ".join(k.__name__ for k in kinds if k is not type(None))
            given = getattr(value, "__name__", repr(value))
            raise ValueError(f"{name}: is {given}, not made by calling {wanted}(...)")


def joint_state(
    game: Game, initial_state: Any, name: str = "initial_state"
) -> jax.Array | np.ndarray:
    """Per-player states, or an (N, n) array, as the joint state (n_1 + ... + n_N,).

    `name`: what the caller calls them.
    """
    sizes = game.state_sizes
    if not isinstance(initial_state, (list, tuple)) and getattr(initial_state, "ndim", 0) == 1:
        split: Any = jnp.split if is_traced(initial_state) else np.split
        initial_state = (
            split(initial_state, np.cumsum(sizes)[:-1])
            if initial_state.shape == (sum(sizes),)
            else initial_state
        )
    parts = list(initial_state)
    if len(parts) != len(sizes):
        raise ValueError(f"{name}: has {len(parts)} states; expected one per player, sizes {sizes}")
    for i, (part, size) in enumerate(zip(parts, sizes, strict=True)):
        if np.shape(part) != (size,):
            raise ValueError(f"{name}[{i}]: has shape {np.shape(part)}; expected ({size},)")
    if is_traced(parts):
        return jnp.concatenate([jnp.asarray(p) for p in parts])
    return np.concatenate([np.asarray(p, dtype=float) for p in parts])


def check_parameters(
    game: Game,
    initial_state: Any,
    theta: Sequence[Theta],
    gamma: Any,
    state_name: str = "initial_state",
) -> Parameters:
    """Shapes and values of a game's parameters; `ValueError` names the argument and the cure.

    `state_name`: what the caller calls `initial_state`.
    """
    layout = layout_of(game)
    count = len(game.players)
    state = joint_state(game, initial_state, state_name)
    if isinstance(theta, dict) or len(theta) != count:
        raise ValueError(f"theta: expected {count} mappings, one per player")
    thetas = tuple({name: _entry(name, value) for name, value in p.items()} for p in theta)
    gamma = jnp.asarray(gamma) if is_traced(gamma) else np.asarray(gamma, dtype=float)
    if gamma.shape not in ((), (count,)):
        raise ValueError(f"gamma: has shape {gamma.shape}; expected a number or ({count},)")
    discounts = (
        jnp.broadcast_to(gamma, (count,)) if is_traced(gamma) else np.broadcast_to(gamma, (count,))
    )
    for name, value in ((state_name, state), ("theta", thetas), ("gamma", discounts)):
        leaves = jax.tree.leaves(value)
        if not is_traced(leaves) and not all(_is_finite(v) for v in leaves):
            raise ValueError(f"{name}: contains NaN or infinity; expected finite numbers")
    if not is_traced(discounts):
        families = [p.discounting for p in game.players]
        for i, (family, value) in enumerate(zip(families, discounts, strict=True)):
            least, most = family.limits
            if not least <= value <= most:
                kind = type(family).__name__
                raise ValueError(
                    f"gamma[{i}]: is {float(value):g}; {kind} discounting takes {least:g} to "
                    f"{most:g}"
                )
    _check_penalties(game, thetas)
    if not is_traced(state):
        low, high = layout.bounds
        outside = (state < low[0, : layout.n] - BOUND_SLACK) | (
            state > high[0, : layout.n] + BOUND_SLACK
        )
        if outside.any():
            entry = int(np.flatnonzero(outside)[0])
            player = int(layout.state_owner[entry])
            raise ValueError(
                f"{state_name}[{player}]: entry {entry - layout.state_slices[player].start} is "
                f"{float(state[entry]):.6g}, outside the player's hard state bounds "
                f"[{low[0, entry]:g}, {high[0, entry]:g}]; clip it or widen the bounds"
            )
    parameters = Parameters(state, thetas, discounts)
    structure = jax.tree.structure(thetas)
    shapes = tuple(np.shape(v) for v in jax.tree.leaves(thetas))
    with jax.enable_x64(True):  # shapes are asked for in the precision that solvers use
        _check_functions(layout, structure, shapes)
    return parameters


def _check_penalties(game: Game, thetas: tuple[Theta, ...]) -> None:
    for i, player in enumerate(game.players):
        for constraint in player.inequalities:
            if not isinstance(constraint.penalty, str):
                continue
            price = thetas[i].get(constraint.penalty, 1.0)
            if not is_traced(price) and not np.all(np.asarray(price) > 0.0):
                raise ValueError(
                    f"theta[{i}][{constraint.penalty!r}]: is {np.asarray(price)}; a penalty is "
                    "more than 0 (leave the constraint out if it costs nothing)"
                )


def _is_finite(value: np.ndarray) -> bool:
    return math.isfinite(value) if value.ndim == 0 else bool(np.isfinite(value).all())


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.generic, jax.Array)) and np.ndim(value) == 0


def _entry(name: str, value: Any) -> Any:
    """One entry of `theta`: arrays and nested PyTrees as they are, lists of numbers as arrays."""
    if isinstance(value, (float, int)) or (
        isinstance(value, np.ndarray) and value.dtype == np.float64
    ):
        return np.asarray(value, dtype=float)
    if isinstance(value, (list, tuple)) and all(_is_number(v) for v in value):
        value = jnp.stack([*map(jnp.asarray, value)]) if is_traced(value) else np.asarray(value)
    try:
        return jax.tree.map(lambda v: v if is_traced(v) else np.asarray(v, dtype=float), value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"theta[{name!r}]: is not numeric ({error})") from error


@lru_cache(maxsize=256)
def _check_functions(layout: Layout, structure: Any, shapes: tuple[tuple[int, ...], ...]) -> None:
    """Every cost is a scalar and every constraint a vector of its stated size."""
    game = layout.game
    thetas = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(s, float) for s in shapes])
    x = tuple(jax.ShapeDtypeStruct((n,), float) for n in game.state_sizes)
    u = tuple(jax.ShapeDtypeStruct((m,), float) for m in game.control_sizes)
    t = jax.ShapeDtypeStruct((), int)
    parts, arguments = tuple(parts_of(game)), (t, x, u, thetas)
    for part in parts:
        try:
            out = abstract_value(part, arguments, None)
        except KeyError as error:
            raise ValueError(f"{part.name}: theta has no entry {error}; add it") from error
        except Exception as error:
            raise ValueError(
                f"{part.name}: cannot be evaluated on this game's states and controls"
                f"{_entries_read(part, arguments)}: {error}"
            ) from error
        scalar_row = part.rows and part.shape == (1,) and out.shape == ()
        if out.shape != part.shape and not scalar_row:
            wanted = "a scalar" if part.shape == () else f"shape {part.shape}, its stated size"
            raise ValueError(f"{part.name}: returns shape {out.shape}; expected {wanted}")
    for i, player in enumerate(game.players):
        for k, inequality in enumerate(player.inequalities):
            price = inequality.penalty
            if isinstance(price, str) and price not in thetas[i]:
                raise ValueError(
                    f"players[{i}].inequalities[{k}]: theta has no entry {price!r} for its penalty"
                )
    check_entries_are_read(game, parts, arguments, thetas)


def _entries_read(part: Part, arguments: Sequence[Any]) -> str:
    """Shapes of the entries of `theta` that a function had read when it failed."""
    thetas = arguments[-1]
    reads: list[set[str]] = [set() for _ in thetas]
    with suppress(Exception):
        abstract_value(part, arguments, reads)
    told = [
        f"theta[{i}][{name!r}] of shape {theta[name].shape}"
        for i, (theta, read) in enumerate(zip(thetas, reads, strict=True))
        for name in sorted(read & set(theta))
        if hasattr(theta[name], "shape")
    ]
    return f" with {', '.join(told)}" if told else ""
