"""A discounted dynamic game: players, horizon and shared constraints (paper, eq. 3).

Player i minimises `sum_t Gamma^i(t; gamma^i) * sum_k cost_k(i, t, x_{t+1}, u_t; theta^i)` over its
own controls, t = 1..T. Stage t charges control `u_t` and the state it leads to; `x_1` is given.
Each player moves by its own dynamics; players meet in costs and constraints.

Games are hashable: two equal games share one compiled solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foresight_env.annotations import no_type_check
from foresight_env.games.constraints import Bounds, Equality, Inequality, SharedInequality
from foresight_env.games.discounting import Discounting, Exponential
from foresight_env.games.dynamics import Dynamics
from foresight_env.games.types import CostFunction


def check_hashable(where: str, part: object) -> None:
    """Games are compared and hashed, so every part of one must be hashable."""
    try:
        hash(part)
    except TypeError as error:
        raise ValueError(
            f"{where} ({type(part).__name__}): {error}; make it a frozen dataclass with fields of "
            "numbers, strings or tuples (arrays belong into theta)"
        ) from error


def as_tuples(owner: object, *fields: str) -> None:
    """Turn lists in the named fields of a frozen dataclass into tuples of hashable parts."""
    for field in fields:
        value = getattr(owner, field)
        if not isinstance(value, (list, tuple)):
            raise ValueError(f"{field}: is a {type(value).__name__}; expected a tuple of them")
        for k, part in enumerate(value):
            check_hashable(f"{field}[{k}]", part)
        object.__setattr__(owner, field, tuple(value))


def check_kind(where: str, part: object, kind: type, members: str) -> None:
    """Raise `ValueError` where an object lacks a protocol's members, or is a class."""
    if isinstance(part, type) or not isinstance(part, kind):
        raise ValueError(
            f"{where}: is {part!r}; expected an object with {members} ({kind.__name__})"
        )


def check_cost(where: str, cost: object) -> None:
    """Raise `ValueError` where a cost is not a function `cost(i, t, x, u, theta)`."""
    if not callable(cost) or isinstance(cost, type):
        raise ValueError(f"{where}: is {cost!r}; expected a callable, cost(i, t, x, u, theta)")


def check_parts(where: str, parts: Sequence[object], kind: type) -> None:
    """Raise `ValueError` where an entry is not of this type."""
    for k, part in enumerate(parts):
        if not isinstance(part, kind):
            raise ValueError(f"{where}[{k}]: is {part!r}; expected {kind.__name__}(...)")


@no_type_check
@dataclass(frozen=True)
class Player:
    """One player of a game: motion, costs and limits.

    Raises:
        ValueError: a field has the wrong type or cannot be hashed; the message names it.
    """

    dynamics: Dynamics
    """Motion of one step, from state (n_i,) and control (m_i,) to the next state; SI units."""
    costs: tuple[CostFunction, ...]
    """Stage costs `cost(i, t, x, u, theta)`, discounted; `x` is what the controls `u` lead to."""
    undiscounted_costs: tuple[CostFunction, ...] = ()
    """Stage costs that count fully at every stage (the reference implementation's proximity)."""
    discounting: Discounting = Exponential()
    """Weights of the stages as a function of the discount factor."""
    state_bounds: Bounds | None = None
    """Bounds on the states from `x_2` on."""
    control_bounds: Bounds | None = None
    """Bounds on all controls."""
    inequalities: tuple[Inequality, ...] = ()
    """Constraints `g >= 0` of this player alone, hard or with a penalty."""
    equalities: tuple[Equality, ...] = ()
    """Constraints `h = 0` of this player alone."""
    name: str = ""
    """For messages and tables."""
    extra_theta: tuple[str, ...] = ()
    """Entries that `theta` may have although no cost or constraint reads them, such as a goal that
    only an environment asks for. Any other entry that is not read is refused as a misspelt one."""

    def __post_init__(self) -> None:
        as_tuples(self, "costs", "undiscounted_costs", "inequalities", "equalities", "extra_theta")
        check_kind("dynamics", self.dynamics, Dynamics, "state_size, control_size and linear")
        check_kind("discounting", self.discounting, Discounting, "limits, weight and ratio")
        for field in ("costs", "undiscounted_costs"):
            for k, cost in enumerate(getattr(self, field)):
                check_cost(f"{field}[{k}]", cost)
        for field, kind in (("inequalities", Inequality), ("equalities", Equality)):
            check_parts(field, getattr(self, field), kind)
        check_parts("extra_theta", self.extra_theta, str)
        for field in ("state_bounds", "control_bounds"):
            bounds = getattr(self, field)
            if not isinstance(bounds, Bounds | None):
                raise ValueError(f"{field}: is {bounds!r}; expected Bounds.box(...) or None")
        check_hashable("dynamics", self.dynamics)
        check_hashable("discounting", self.discounting)


@no_type_check
@dataclass(frozen=True)
class Game:
    """Dynamic game: players, a horizon, and constraints that bind several players.

    Games are compared and hashed by value; equal games share one compiled solver.

    Raises:
        ValueError: a field has the wrong type, bounds have the wrong shape, or a player's dynamics
            have another time step; the message names it.
    """

    players: tuple[Player, ...]
    """N >= 1 players; their order is that of states, parameters and discount factors."""
    horizon: int
    """Number T >= 1 of stages; trajectories have T + 1 states."""
    shared: tuple[SharedInequality, ...] = ()
    """Constraints that bind several players."""
    dt: float = 0.0
    """Duration of a stage, s; 0 takes that of the dynamics, or 0.1 where none states it."""

    def __post_init__(self) -> None:
        as_tuples(self, "players", "shared")
        check_parts("players", self.players, Player)
        check_parts("shared", self.shared, SharedInequality)
        if not self.players:
            raise ValueError("players: a game needs at least one player")
        if not isinstance(self.horizon, int) or self.horizon < 1:
            raise ValueError(f"horizon: is {self.horizon!r}; expected a whole number above 0")
        for number, constraint in enumerate(self.shared):
            for i in constraint.players or ():
                if not 0 <= i < len(self.players):
                    raise ValueError(
                        f"shared[{number}].players: names player {i}, but the game's players are "
                        f"0..{len(self.players) - 1}"
                    )
        steps = [getattr(p.dynamics, "dt", None) for p in self.players]
        if self.dt == 0.0:
            object.__setattr__(self, "dt", next((s for s in steps if s is not None), 0.1))
        for i, player in enumerate(self.players):
            step = self.dt if steps[i] is None else steps[i]
            if step != self.dt:
                raise ValueError(
                    f"dt: is {self.dt} s, but players[{i}].dynamics moves by {step} s; make them "
                    "equal"
                )
            sizes = {
                "state_bounds": player.dynamics.state_size,
                "control_bounds": player.dynamics.control_size,
            }
            for name, size in sizes.items():
                bounds: Bounds | None = getattr(player, name)
                if bounds is None:
                    continue
                for rows in (bounds.lower, bounds.upper):
                    if len(rows) not in (1, self.horizon) or len(rows[0]) != size:
                        raise ValueError(
                            f"players[{i}].{name}: has shape ({len(rows)}, {len(rows[0])}); "
                            f"expected (1, {size}) or ({self.horizon}, {size})"
                        )

    @property
    def state_sizes(self) -> tuple[int, ...]:
        """Each player's state size."""
        return tuple(p.dynamics.state_size for p in self.players)

    @property
    def control_sizes(self) -> tuple[int, ...]:
        """Each player's control size."""
        return tuple(p.dynamics.control_size for p in self.players)


def inside_bounds(
    game: Game, states: Sequence[Float[np.ndarray, "_"]]
) -> tuple[Float[np.ndarray, "_"], ...]:
    """Return states clipped into the players' bounds: estimates may lie just outside.

    Args:
        game: with the bounds of the first stage.
        states: per-player states (n_i,).

    Returns:
        Per-player states (n_i,).
    """
    out = []
    for player, state in zip(game.players, states, strict=True):
        box = player.state_bounds
        out.append(state if box is None else np.clip(state, box.lower[0], box.upper[0]))
    return tuple(out)
