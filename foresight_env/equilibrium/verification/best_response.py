"""One player's own problem with the other players' plans fixed: a game of one.

The fixed plans travel in the game's `theta`, so that one compiled game serves all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.identical_players import runs_of
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.constraints import Inequality
from foresight_env.games.costs import Composite
from foresight_env.games.game import Game, Player
from foresight_env.games.permutation import distinguishes
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta


@dataclass(frozen=True)
class _Alone:
    """A cost or constraint of player `i` as seen with the other players' plans fixed.

    The fixed plans travel in `theta` as `states` and `controls`, the player's own entries as `own`.
    """

    function: Any
    player: int

    def arguments(
        self, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> tuple[int, StageNumber, States, Controls, Theta]:
        xs = [theta["states"][str(j)][t - 1] for j in range(len(theta["states"]))]
        us = [theta["controls"][str(j)][t - 1] for j in range(len(theta["controls"]))]
        xs[self.player], us[self.player] = x[0], u[0]
        return self.player, t, tuple(xs), tuple(us), theta["own"]

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Array:
        return jnp.asarray(self.function(*self.arguments(t, x, u, theta)))


@dataclass(frozen=True)
class _AloneComposite(_Alone):
    def residual(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Array:
        return self.function.residual(*self.arguments(t, x, u, theta))

    def loss(self, value: Array, theta: Theta) -> Scalar:
        return self.function.loss(value, theta["own"])


@dataclass(frozen=True)
class _SharedAlone(_Alone):
    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Array:
        _, t, xs, us, _ = self.arguments(t, x, u, theta)
        return jnp.asarray(self.function(t, xs, us, theta["all"]))


@lru_cache(maxsize=256)
def best_response_game(game: Game, i: int) -> Game:
    """Player `i`'s own problem as a game of one; see `best_response_theta` for its parameters."""
    player = game.players[i]

    def alone(cost: Any) -> Any:
        return (_AloneComposite if isinstance(cost, Composite) else _Alone)(cost, i)

    inequalities = [replace(c, function=_Alone(c.function, i)) for c in player.inequalities]
    for shared in game.shared:
        if shared.players is None or i in shared.players:
            inequalities.append(Inequality(_SharedAlone(shared.function, i), shared.size))
    single = Player(
        player.dynamics,
        tuple(alone(c) for c in player.costs),
        tuple(alone(c) for c in player.undiscounted_costs),
        player.discounting,
        player.state_bounds,
        player.control_bounds,
        tuple(inequalities),
        tuple(replace(c, function=_Alone(c.function, i)) for c in player.equalities),
        player.name,
        # Fixed plans and parameters, of which constraints and costs may leave some unread.
        ("own", "all", "states", "controls"),
    )
    return Game((single,), game.horizon, (), game.dt)


def same_best_response(game: Game, thetas: tuple[Theta, ...]) -> tuple[range, ...]:
    """Runs of neighbouring players that one best-response game serves, that of the first of them.

    Equal players with parameters of the same shapes, whose costs and constraints do not depend on
    players' numbers (`games.permutation`). Shared constraints do.
    """
    shapes = [
        (jax.tree.structure(theta), [np.shape(v) for v in jax.tree.leaves(theta)])
        for theta in thetas
    ]

    def same(i: int, j: int) -> bool:
        first, second = (replace(game.players[k], name="") for k in (i, j))
        parts: list[Any] = [*first.costs, *first.undiscounted_costs]
        parts += [c.function for c in first.inequalities]
        parts += [c.function for c in first.equalities]
        return (
            not game.shared
            and first == second
            and shapes[i] == shapes[j]
            and not any(distinguishes(part, i, j) for part in parts)
        )

    return runs_of(range(len(game.players)), same)


def best_response_theta(
    layout: Layout,
    i: int,
    thetas: tuple[Theta, ...],
    x: Array,
    u: Array,
    *,
    place: int | None = None,
) -> Theta:
    """Parameters of `best_response_game`: own entries, all players' plans, named penalties.

    With `place`: of that player's game, which has player `i` there and all others in their order.
    """
    order = [j for j in range(len(thetas)) if j != i]
    order.insert(i if place is None else place, i)
    states, controls = layout.state_slices, layout.control_slices
    return {
        "own": thetas[i],
        "all": tuple(thetas[j] for j in order),
        "states": {str(k): x[:, states[j]] for k, j in enumerate(order)},
        "controls": {str(k): u[:, controls[j]] for k, j in enumerate(order)},
        **_prices(layout.game, i, thetas[i]),
    }


def best_response_parameters(
    game: Game, i: int, own: Theta, others: Mapping[int, Float[np.ndarray, "T _"]]
) -> dict[str, Any]:
    """`theta` of `best_response_game` from predictions: others' states after stages 1..T.

    Others' controls count as zero and their parameters as player i's own.
    """
    horizon = game.horizon
    states = [
        np.zeros((horizon, p.dynamics.state_size)) if j == i else np.asarray(others[j])
        for j, p in enumerate(game.players)
    ]
    for j, s in enumerate(states):
        expected = (horizon, game.players[j].dynamics.state_size)
        if s.shape != expected:
            raise ValueError(f"others[{j}]: has shape {s.shape}; expected {expected}")
    return {
        "own": dict(own),
        "all": tuple(dict(own) for _ in game.players),
        "states": {str(j): s for j, s in enumerate(states)},
        "controls": {
            str(j): np.zeros((horizon, p.dynamics.control_size)) for j, p in enumerate(game.players)
        },
        **_prices(game, i, own),
    }


def _prices(game: Game, i: int, own: Theta) -> dict[str, Any]:
    """Named penalties are looked up at the top of `theta`."""
    named = (c.penalty for c in game.players[i].inequalities)
    return {name: own[name] for name in named if isinstance(name, str)}
