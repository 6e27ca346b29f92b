"""Identical neighbouring players, evaluated together (vmapped) as the first of them.

XLA's time for a small game, to compile it and to run it, is proportional to the number of its
operations. So costs and constraints that do not depend on players' numbers (`games.permutation`)
are evaluated once, along an axis of such players, each in the first one's place of a reordered
stage vector; dynamics, which depend on no other player, along an axis of players with equal ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.game import Game
from foresight_env.games.permutation import Parametric, distinguishes
from foresight_env.games.types import ConstraintFunction, CostFunction, Theta


class IdenticalPlayers(NamedTuple):
    """A run of identical players with their common costs and constraints."""

    members: range
    costs: tuple[CostFunction, ...]
    undiscounted_costs: tuple[CostFunction, ...]
    constraints: tuple[ConstraintFunction, ...]
    constants: tuple[Any, ...]
    """Of each cost and then of each undiscounted one, the members' own numbers along a first axis
    (`games.permutation.Parametric`); None of those without."""
    rows: Int[np.ndarray, "G R"]
    """Numbers of each member's constraint rows."""
    view: Int[np.ndarray, "G w"]
    """Entries of `w` with the member in the first one's place, all others in their order."""
    back: Int[np.ndarray, "G w"]
    """Places of the entries of `w` in that view."""

    @property
    def first(self) -> int:
        """Whose number costs and constraints are given."""
        return self.members.start


def identical_players(layout: Layout, thetas: tuple[Theta, ...]) -> tuple[IdenticalPlayers, ...]:
    """Return every cost and constraint once, with the identical players that have it.

    Identical players are neighbours with parameters of the same shapes.
    """
    shapes = tuple(
        (jax.tree.structure(theta), tuple(np.shape(v) for v in jax.tree.leaves(theta)))
        for theta in thetas
    )
    return _identical_players(layout, shapes)


@lru_cache(maxsize=256)
def _identical_players(layout: Layout, shapes: tuple[Any, ...]) -> tuple[IdenticalPlayers, ...]:
    game = layout.game
    owners: dict[_Part, list[int]] = {}
    originals: dict[tuple[_Part, int], Any] = {}
    rows: dict[tuple[_Part, int], range] = {}
    place = 0
    for i, player in enumerate(game.players):
        seen: Counter[tuple[str, Any]] = Counter()
        constraints = layout.own_constraints(i)
        for kind, parts in zip(
            _KINDS, (player.costs, player.undiscounted_costs, constraints), strict=True
        ):
            for original in parts:
                what = _general(original)
                part = _Part(kind, what, seen[kind, what])
                seen[kind, what] += 1
                originals[part, i] = original
                owners.setdefault(part, []).append(i)
                if kind == "constraint":
                    rows[part, i] = range(place, place + part.what.size)
                    place += part.what.size
    together: dict[range, list[_Part]] = {}
    for part, players in owners.items():

        def alike(i: int, j: int, part: _Part = part) -> bool:
            sizes = game.state_sizes, game.control_sizes
            return (
                all(size[i] == size[j] for size in sizes)
                and shapes[i] == shapes[j]
                and _sizes(originals[part, i]) == _sizes(originals[part, j])
                and not distinguishes(part.function, i, j)
            )

        for run in runs_of(players, alike):
            together.setdefault(run, []).append(part)
    return tuple(_together(layout, run, parts, rows, originals) for run, parts in together.items())


_KINDS = ("cost", "undiscounted cost", "constraint")


class _Part(NamedTuple):
    """One cost or constraint of a player."""

    kind: str
    what: Any
    copy: int
    """Number of this part among equal ones of one player."""

    @property
    def function(self) -> Any:
        return self.what.function if self.kind == "constraint" else self.what


def _together(
    layout: Layout,
    members: range,
    parts: list[_Part],
    rows: dict[tuple[_Part, int], range],
    originals: dict[tuple[_Part, int], Any],
) -> IdenticalPlayers:
    costs, undiscounted, constraints = (
        [part for part in parts if part.kind == kind] for kind in _KINDS
    )
    numbers = [[row for part in constraints for row in rows[part, i]] for i in members]
    everyone = range(len(layout.game.players))
    entries = [
        np.r_[layout.state_slices[j], _shifted(layout.control_slices[j], layout.n)]
        for j in everyone
    ]
    view = np.empty((len(members), layout.n + layout.m), int)
    for number, i in enumerate(members):
        order = [j for j in everyone if j != i]
        order.insert(members.start, i)
        for j, seen in zip(everyone, order, strict=True):
            view[number, entries[j]] = entries[seen]
    return IdenticalPlayers(
        members,
        tuple(part.function for part in costs),
        tuple(part.function for part in undiscounted),
        tuple(part.function for part in constraints),
        tuple(_stacked([originals[part, i] for i in members]) for part in (*costs, *undiscounted)),
        np.array(numbers, dtype=int).reshape(len(members), -1),
        view,
        np.argsort(view, axis=1),
    )


def _is_parametric(what: Any) -> bool:
    """Whether a cost is a function of its constants.

    Classes that inherit this from another, and compute something else, are not.
    """
    if not isinstance(what, Parametric):
        return False

    def owner(name: str) -> type | None:
        return next((c for c in type(what).__mro__ if name in vars(c)), None)

    computing = {owner(name) for name in ("__call__", "residual", "loss")} - {None}
    return computing == {owner("without_constants")}


def _general(what: Any) -> Any:
    """A cost without the numbers that identical players may differ in."""
    return what.without_constants() if _is_parametric(what) else what


def _sizes(what: Any) -> tuple[tuple[int, ...], ...]:
    """Shapes of the numbers that identical players may differ in."""
    if not _is_parametric(what):
        return ()
    return tuple(np.shape(v) for v in jax.tree.leaves(what.constants()))


def _stacked(costs: list[Any]) -> Any:
    """The numbers of the members' costs along a new first axis, where they have any."""
    if not _is_parametric(costs[0]):
        return None
    return jax.tree.map(lambda *v: np.stack(v), *(cost.constants() for cost in costs))


def _shifted(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)


@lru_cache(maxsize=256)
def moving_alike(game: Game) -> tuple[range, ...]:
    """Runs of players that have the same dynamics."""

    def same(i: int, j: int) -> bool:
        return game.players[i].dynamics == game.players[j].dynamics

    return runs_of(range(len(game.players)), same)


def runs_of(numbers: Sequence[int], same: Callable[[int, int], bool]) -> tuple[range, ...]:
    """Neighbours that are the same as their run's first."""
    runs = [range(numbers[0], numbers[0] + 1)]
    for i in numbers[1:]:
        last = runs[-1]
        if i == last.stop and same(last.start, i):
            runs[-1] = range(last.start, i + 1)
        else:
            runs.append(range(i, i + 1))
    return tuple(runs)


def stack(values: Any, members: range) -> Any:
    """The members' entries of a sequence of PyTrees along a new first axis."""
    return jax.tree.map(lambda *v: jnp.stack([*map(jnp.asarray, v)]), *(values[i] for i in members))


def apart(
    values: Float[Array, "*T n"], slices: tuple[slice, ...], members: range
) -> Float[Array, "*T G k"]:
    """The members' parts of a joint vector, one below the other."""
    part = values[..., slices[members.start].start : slices[members[-1]].stop]
    return part.reshape(*part.shape[:-1], len(members), -1)


def inputs_of(
    layout: Layout, x: Float[Array, "*T n"], u: Float[Array, "*T m"], members: range
) -> Float[Array, "*T G k"]:
    """Inputs of the members' dynamics: each one's state, then its control."""
    states, controls = layout.state_slices, layout.control_slices
    return jnp.concatenate([apart(x, states, members), apart(u, controls, members)], axis=-1)


def in_place(
    layout: Layout, members: range, own: Float[Array, "G k *rest"]
) -> Float[Array, "w *rest"]:
    """Members' own parts, of states and then of controls, where they are in a stage vector."""
    size, rest = layout.game.state_sizes[members.start], own.shape[2:]
    parts, filled = [], 0
    for values, slices, begin in (
        (own[:, :size], layout.state_slices, 0),
        (own[:, size:], layout.control_slices, layout.n),
    ):
        start, stop = slices[members.start].start + begin, slices[members[-1]].stop + begin
        parts += [jnp.zeros((start - filled, *rest), own.dtype), values.reshape(-1, *rest)]
        filled = stop
    parts.append(jnp.zeros((layout.n + layout.m - filled, *rest), own.dtype))
    return jnp.concatenate(parts)


def spread(blocks: Float[Array, "*T G a b"]) -> Float[Array, "*T Ga Gb"]:
    """A block-diagonal matrix of the members' blocks."""
    *lead, count, rows, columns = blocks.shape
    own = jnp.eye(count, dtype=bool)[:, None, :, None]
    full = jnp.where(own, blocks[..., :, :, None, :], 0.0)
    return full.reshape(*lead, count * rows, count * columns)


def block_diagonal(parts: list[Float[Array, "*T _ _"]]) -> Float[Array, "*T _ _"]:
    """The same of matrices of different sizes."""
    if len(parts) == 1:
        return parts[0]
    width = sum(part.shape[-1] for part in parts)
    rows, before = [], 0
    for part in parts:
        after = width - before - part.shape[-1]
        rows.append(jnp.pad(part, [(0, 0)] * (part.ndim - 1) + [(before, after)]))
        before += part.shape[-1]
    return jnp.concatenate(rows, axis=-2)
