"""Entries of `theta` that a game's functions read, so that a misspelt one is refused."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any

import jax
import jax.numpy as jnp

from foresight_env.equilibrium.checks.named import Part
from foresight_env.games.game import Game, Player


@jax.tree_util.register_pytree_with_keys_class
class RecordingTheta(dict[str, Any]):
    """A player's `theta` that records in `read` which entries are asked for.

    Access to all of it (iteration, a copy, a PyTree operation) counts as reading every entry.
    """

    def __init__(self, entries: Mapping[str, Any], read: set[str]) -> None:
        super().__init__(entries)
        self.read = read

    def __getitem__(self, name: str) -> Any:
        self.read.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.read.add(name)
        return super().get(name, default)

    def __contains__(self, name: object) -> bool:
        self.read.add(str(name))
        return super().__contains__(name)

    def _all(self) -> dict[str, Any]:
        self.read.update(dict.keys(self))
        return {name: dict.__getitem__(self, name) for name in dict.keys(self)}

    def __iter__(self) -> Iterator[str]:
        # Run-time type checkers look at the first name, which reads nothing.
        yield from dict.__iter__(self)
        self._all()

    def keys(self) -> Any:
        return self._all().keys()

    def values(self) -> Any:
        return self._all().values()

    def items(self) -> Any:
        return self._all().items()

    def copy(self) -> dict[str, Any]:
        return self._all()

    def __or__(self, other: Any) -> Any:
        return self._all() | other

    def __ror__(self, other: Any) -> Any:
        return other | self._all()

    def __eq__(self, other: object) -> bool:
        return self._all() == other

    __hash__ = None

    def tree_flatten_with_keys(self) -> tuple[Any, tuple[str, ...]]:
        entries = self._all()
        names = tuple(sorted(entries))
        return [(jax.tree_util.DictKey(name), entries[name]) for name in names], names

    @classmethod
    def tree_unflatten(cls, names: tuple[str, ...], entries: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(names, entries, strict=True))


def abstract_value(part: Part, arguments: Sequence[Any], reads: Sequence[set[str]] | None) -> Any:
    """Shape of what one of the game's functions returns, nothing computed.

    Args:
        part: the function.
        arguments: shapes of stage, states, controls and `thetas`.
        reads: per player, where the entries of `theta` that it reads are added; None: nowhere.
    """

    def value(t: Any, x: Any, u: Any, thetas: Any) -> Any:
        if reads is not None:
            thetas = tuple(RecordingTheta(theta, r) for theta, r in zip(thetas, reads, strict=True))
        return jnp.asarray(part.function(t, x, u, thetas))

    return jax.eval_shape(value, *arguments)


def check_entries_are_read(
    game: Game, parts: Sequence[Part], arguments: Sequence[Any], thetas: Sequence[Mapping[str, Any]]
) -> None:
    """Raise `ValueError` where an entry of `theta` is neither read nor declared.

    Read are entries that the player's functions or shared constraints ask for, and names that are
    fields of its costs and constraints. Functions that cannot be recorded count as reading all.
    """
    named = [_names(player) for player in game.players]
    left = [set(theta) - names for theta, names in zip(thetas, named, strict=True)]
    if not any(left):
        return
    reads: list[set[str]] = [set() for _ in game.players]
    for part in parts:
        try:
            abstract_value(part, arguments, reads)
        except Exception:  # it works with a plain mapping, so what it reads is not known
            return
    for i, (entries, read) in enumerate(zip(left, reads, strict=True)):
        for name in sorted(entries - read):
            known = sorted(read | named[i])
            close = get_close_matches(name, known, 1)
            cure = f"did you mean {close[0]!r}? " if close else ""
            raise ValueError(
                f"theta[{i}]: has an entry {name!r} that nothing of player {i} reads; {cure}"
                f"entries that are read: {known}; others belong into players[{i}].extra_theta"
            )


def _names(player: Player) -> set[str]:
    """Entries declared by the player, and names that are fields of its functions."""
    functions: list[Any] = [*player.costs, *player.undiscounted_costs]
    constraints: list[Any] = [*player.inequalities, *player.equalities]
    functions += [c.function for c in constraints]
    penalties = {c.penalty for c in player.inequalities if isinstance(c.penalty, str)}
    return {*player.extra_theta, *penalties, *(n for f in functions for n in _fields(f))}


def _fields(part: Any) -> Iterator[str]:
    """Texts among the fields of a dataclass, those of dataclasses in its fields included."""
    if not is_dataclass(part) or isinstance(part, type):
        return
    for field in fields(part):
        value = getattr(part, field.name, None)
        if isinstance(value, str):
            yield value
        else:
            yield from _fields(value)
