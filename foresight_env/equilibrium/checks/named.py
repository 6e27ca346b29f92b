"""Names of a game's functions in error messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from foresight_env.games.game import Game


class Part(NamedTuple):
    """One function of a game: dynamics, cost or constraint."""

    name: str
    """Place in the game and the function's own name: `players[0].costs[1] (Effort)`."""
    function: Callable[..., Any]
    """Of stage, all players' states and controls, all players' theta; for dynamics the states are
    those that the stage starts from, else those that it leads to."""
    shape: tuple[int, ...]
    """Required kind of result."""
    before: bool = False
    """Whether it is a function of the states that a stage starts from (dynamics)."""
    rows: bool = False
    """Whether it is a constraint: a scalar is one row."""


def parts_of(game: Game) -> Iterator[Part]:
    """Dynamics, costs and constraints, player by player, then what is shared."""
    for i, player in enumerate(game.players):
        dynamics = player.dynamics
        yield Part(
            _label(f"players[{i}].dynamics", dynamics),
            lambda t, x, u, thetas, i=i, f=dynamics: f(t, x[i], u[i]),
            (dynamics.state_size,),
            True,
        )

        def own(function: Callable[..., Any], i: int = i) -> Callable[..., Any]:
            return lambda t, x, u, thetas: function(i, t, x, u, thetas[i])

        for kind in ("costs", "undiscounted_costs"):
            for k, cost in enumerate(getattr(player, kind)):
                yield Part(_label(f"players[{i}].{kind}[{k}]", cost), own(cost), ())
        for kind in ("inequalities", "equalities"):
            for k, c in enumerate(getattr(player, kind)):
                where = f"players[{i}].{kind}[{k}]"
                yield Part(_label(where, c.function), own(c.function), (c.size,), rows=True)
    for k, shared in enumerate(game.shared):
        where = _label(f"shared[{k}]", shared.function)
        yield Part(where, shared.function, (shared.size,), rows=True)


def _label(where: str, function: Any) -> str:
    return f"{where} ({getattr(function, '__name__', type(function).__name__)})"
