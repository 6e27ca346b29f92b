"""Layout of a game's joint vectors: each player's slices and constraint rows.

One stage has the joint vector `w = (x^1, ..., x^N, u^1, ..., u^N)`: the states that the stage leads
to, then its controls. Constraint rows of one stage are stacked: own inequalities and equalities
player by player, then shared ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foresight_env.equilibrium.linear_algebra.transitions import EqualSizes
from foresight_env.games.constraints import Bounds, Equality, Inequality, as_rows
from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.game import Game
from foresight_env.games.types import Controls, States, Theta


@dataclass(frozen=True)
class Layout:
    """Static index tables of a game."""

    game: Game

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # Asked for at every call of a compiled program; a game's own is that of all its parts.
        return hash(self.game)

    @cached_property
    def linear(self) -> bool:
        """Whether all dynamics are linear."""
        return all(p.dynamics.linear for p in self.game.players)

    @cached_property
    def n(self) -> int:
        """Joint state size."""
        return sum(self.game.state_sizes)

    @cached_property
    def m(self) -> int:
        """Joint control size."""
        return sum(self.game.control_sizes)

    @cached_property
    def equal_sizes(self) -> EqualSizes | None:
        """The players' common sizes; None where they differ."""
        sizes = set(zip(self.game.state_sizes, self.game.control_sizes, strict=True))
        return EqualSizes(len(self.game.players), *sizes.pop()) if len(sizes) == 1 else None

    @cached_property
    def state_owner(self) -> np.ndarray:
        """(n,) player that each joint-state entry belongs to."""
        return np.repeat(np.arange(len(self.game.players)), self.game.state_sizes)

    @cached_property
    def owner(self) -> np.ndarray:
        """(n + m,) player that each entry of `w` belongs to."""
        controls = np.repeat(np.arange(len(self.game.players)), self.game.control_sizes)
        return np.concatenate([self.state_owner, controls])

    @cached_property
    def state_slices(self) -> tuple[slice, ...]:
        """Slice of each player's state in the joint state."""
        return _slices(self.game.state_sizes)

    @cached_property
    def control_slices(self) -> tuple[slice, ...]:
        """Slice of each player's control in the joint control."""
        return _slices(self.game.control_sizes)

    def split_states(self, x: Float[Array, "n"]) -> States:
        """Joint state -> one vector per player."""
        return tuple(x[s] for s in self.state_slices)

    def split_controls(self, u: Float[Array, "m"]) -> Controls:
        """Joint control -> one vector per player."""
        return tuple(u[s] for s in self.control_slices)

    def split(self, w: Float[Array, "w"]) -> tuple[States, Controls]:
        """Stage vector -> per-player states and controls."""
        return self.split_states(w[: self.n]), self.split_controls(w[self.n :])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(T, n + m) lower and upper bounds, infinite where there are none."""
        low, high = [], []
        for which in ("state", "control"):
            for player in self.game.players:
                size = getattr(player.dynamics, f"{which}_size")
                box: Bounds | None = getattr(player, f"{which}_bounds")
                shape = (self.game.horizon, size)
                low.append(np.broadcast_to(-np.inf if box is None else box.lower, shape))
                high.append(np.broadcast_to(np.inf if box is None else box.upper, shape))
        return np.concatenate(low, axis=1), np.concatenate(high, axis=1)

    @cached_property
    def rows(self) -> tuple[ConstraintRow, ...]:
        """One description per constraint row of a stage."""
        count = len(self.game.players)
        rows: list[ConstraintRow] = []
        for i, player in enumerate(self.game.players):
            bound = tuple(j == i for j in range(count))
            for inequality in player.inequalities:
                kind = "hard" if inequality.penalty is None else "elastic"
                rows += [ConstraintRow(kind, bound, i, inequality.penalty)] * inequality.size
            for equality in player.equalities:
                rows += [ConstraintRow("equality", bound, i, None)] * equality.size
        for constraint in self.game.shared:
            bound = tuple(
                constraint.players is None or j in constraint.players for j in range(count)
            )
            rows += [
                ConstraintRow("hard", bound, -1, None, constraint.multiplier == "common")
            ] * constraint.size
        return tuple(rows)

    @cached_property
    def elastic(self) -> Bool[np.ndarray, "K"]:
        """(K,) rows that may be violated at a price."""
        return np.array([r.kind == "elastic" for r in self.rows], dtype=bool)

    @cached_property
    def equality(self) -> Bool[np.ndarray, "K"]:
        """(K,) rows that must be zero."""
        return np.array([r.kind == "equality" for r in self.rows], dtype=bool)

    @cached_property
    def pair_count(self) -> int:
        """Columns of slacks and multipliers, as in module `pairs`."""
        return 2 * (self.n + self.m + len(self.rows))

    def constraint_values(
        self, t: Array, w: Float[Array, "w"], thetas: tuple[Theta, ...]
    ) -> Float[Array, "K"]:
        """All constraint rows of stage `t`."""
        x, u = self.split(w)
        parts = [
            as_rows(constraint.function(i, t, x, u, thetas[i]))
            for i in range(len(self.game.players))
            for constraint in self.own_constraints(i)
        ]
        return jnp.concatenate([*parts, self.shared_values(t, w, thetas)])

    def own_constraints(self, i: int) -> tuple[Inequality | Equality, ...]:
        """Player i's, in the order of its rows."""
        player = self.game.players[i]
        return (*player.inequalities, *player.equalities)

    def shared_values(
        self, t: Array, w: Float[Array, "w"], thetas: tuple[Theta, ...]
    ) -> Float[Array, "shared"]:
        """The shared constraint rows of stage `t`, which are the last."""
        x, u = self.split(w)
        parts = [as_rows(shared.function(t, x, u, thetas)) for shared in self.game.shared]
        return jnp.concatenate([jnp.zeros(0, w.dtype), *parts])

    def penalties(self, thetas: tuple[Theta, ...]) -> Float[Array, "K"]:
        """(K,) upper limits of elastic multipliers; 1 for the other rows, which do not use it."""
        values = [
            jnp.ones(()) if r.penalty is None else weight_value(r.penalty, thetas[r.player])
            for r in self.rows
        ]
        return jnp.stack(values) if values else jnp.zeros(0)


@dataclass(frozen=True)
class ConstraintRow:
    """One constraint row: its kind, whom it binds, whose `theta` prices it, how it is shared."""

    kind: str
    binds: tuple[bool, ...]
    player: int
    penalty: Weight | None
    common: bool = False


def _slices(sizes: tuple[int, ...]) -> tuple[slice, ...]:
    ends = np.cumsum((0, *sizes))
    return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))


@lru_cache(maxsize=256)
def layout_of(game: Game) -> Layout:
    """The (cached) layout of `game`."""
    return Layout(game)
