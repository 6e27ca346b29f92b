"""Constraints: bounds, inequalities `g >= 0`, equalities `g == 0`, own or shared, hard or elastic.

An *elastic* inequality is the exact penalty `penalty * max(0, -g)`, the paper's soft collision
cost. Solvers treat it as an inequality whose multiplier is at most `penalty`, which keeps the game
smooth where the penalty has a kink.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.annotations import no_type_check
from foresight_env.games.costs import Weight, weight_value
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.types import (
    ConstraintFunction,
    Controls,
    SharedConstraintFunction,
    StageNumber,
    States,
    Theta,
)
from foresight_env.games.vectors import squared_length

BoundRows = tuple[tuple[float, ...], ...]
Limit = float | Sequence[float] | np.ndarray
"""One side of a box: a number for all entries, one per entry, or one row per stage."""


@dataclass(frozen=True)
class Bounds:
    """`lower <= value <= upper`, per entry and, where a user wants it, per stage.

    Build it with `Bounds.box`; infinite entries are free.
    """

    lower: BoundRows
    upper: BoundRows

    @staticmethod
    def box(lower: Limit, upper: Limit, size: int) -> Bounds:
        """Return bounds of every entry.

        Args:
            lower, upper: a number, (size,), or (T, size) where they vary with the stage; infinity
                leaves an entry free.
            size: number of entries of the state or control.

        Returns:
            The bounds.

        Raises:
            ValueError: a limit has the wrong shape or is NaN, or `lower` is not below `upper`.
        """
        rows = []
        for name, value in (("lower", lower), ("upper", upper)):
            array = np.asarray(value, dtype=float)
            if np.isnan(array).any():
                raise ValueError(f"{name}: contains NaN; use infinity for a free entry")
            if array.ndim > 2 or (array.ndim and array.shape[-1] != size):
                raise ValueError(
                    f"{name}: has shape {array.shape}; expected a number, ({size},) or (T, {size})"
                )
            full = np.broadcast_to(array, (*array.shape[:-1], size)) if array.ndim < 2 else array
            rows.append(np.atleast_2d(full))
        if not (rows[0] < rows[1]).all():
            raise ValueError("lower: must be below upper everywhere (use an equality to fix it)")
        low, high = (tuple(tuple(float(v) for v in row) for row in array) for array in rows)
        return Bounds(low, high)


def as_rows(value: Any) -> Float[Array, "rows"]:
    """A constraint's value as a vector: a scalar is one row."""
    rows = jnp.asarray(value)
    return rows[None] if rows.ndim == 0 else rows


def _check_constraint(function: object, size: object) -> None:
    if not callable(function) or isinstance(function, type):
        raise ValueError(f"function: is {function!r}; expected a callable")
    if isinstance(size, bool) or not isinstance(size, Integral) or size < 1:
        raise ValueError(f"size: is {size!r}; expected a whole number above 0")


@no_type_check
@dataclass(frozen=True)
class Inequality:
    """One player's own inequality `function(i, t, x, u, theta) >= 0` at every stage, (size,).

    A function of one row may return a scalar. `penalty=None` is hard; a positive number, or the
    name of an entry of `theta`, makes it elastic.
    """

    function: ConstraintFunction
    size: int
    penalty: Weight | None = None

    def __post_init__(self) -> None:
        _check_constraint(self.function, self.size)
        if isinstance(self.penalty, (int, float)) and not self.penalty > 0.0:
            raise ValueError(
                f"penalty: is {self.penalty}; expected more than 0, or None for a hard constraint"
            )


@no_type_check
@dataclass(frozen=True)
class Equality:
    """One player's own equality `function(i, t, x, u, theta) == 0` at every stage, (size,)."""

    function: ConstraintFunction
    size: int

    def __post_init__(self) -> None:
        _check_constraint(self.function, self.size)


@no_type_check
@dataclass(frozen=True)
class SharedInequality:
    """`function(t, x, u, thetas) >= 0` at every stage, (size,), binding several players.

    A shared constraint leaves open who gives way. `multiplier` says which equilibrium is meant:

    - `"individual"`: the players' multipliers are equal in their own current values, so that each
      feels the constraint at stage t as strongly relative to its own stage cost at t;
    - `"common"`: one multiplier in present values (the normalised equilibrium of Rosen, 1965). The
      larger a player's gamma is, the less the constraint weighs for it late in the game.

    `players`: indices of those bound; None means all.
    """

    function: SharedConstraintFunction
    size: int
    multiplier: Literal["individual", "common"] = "individual"
    players: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        _check_constraint(self.function, self.size)
        if self.multiplier not in ("individual", "common"):
            raise ValueError(
                f'multiplier: is {self.multiplier!r}; expected "individual" or "common"'
            )


@dataclass(frozen=True)
class MinimumDistance(PermutationInvariant):
    """`||p_i - p_j||^2 - threshold` for every other player j, (N - 1,), m^2 (paper, eq. 6).

    The paper writes `threshold = delta * d_min`; it is compared with a *squared* distance.
    """

    threshold: Weight

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "others"]:
        gaps = [squared_length(x[i][:2] - xj[:2]) for j, xj in enumerate(x) if j != i]
        return jnp.stack(gaps) - weight_value(self.threshold, theta)


@dataclass(frozen=True)
class SharedMinimumDistance:
    """`||p_i - p_j||^2 - threshold` for every pair i < j, (N (N - 1) / 2,), m^2, as shared rows."""

    threshold: float

    def __call__(
        self, t: StageNumber, x: States, u: Controls, thetas: tuple[Theta, ...]
    ) -> Float[Array, "pairs"]:
        pairs = [(i, j) for i in range(len(x)) for j in range(i + 1, len(x))]
        gaps = [squared_length(x[i][:2] - x[j][:2]) for i, j in pairs]
        return jnp.stack(gaps) - self.threshold
