"""The ego's best response to several hypotheses about the others: the least expected cost.

Within a hypothesis the others follow given paths, whatever the ego does. One plan serves all
hypotheses: it is made again at every step, with other weights. Plans with a branch per hypothesis
after common first stages (Peters et al., "Contingency games for multi-agent interaction", RA-L
2024) cost the same in the closed loop and took two to three times as long
(docs/development/design.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)
from foresight_env.games import Game, Inequality
from foresight_env.games.costs import Composite
from foresight_env.games.types import Controls, Scalar, StageNumber, States, Theta


@dataclass(frozen=True)
class _Expected:
    """Expectation of a cost of the ego's own problem over the hypotheses."""

    function: Any

    def each(
        self, function: Any, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "count *_"]:
        """A function's value under every hypothesis."""

        def one(others: Any) -> Float[Array, "*_"]:
            return jnp.asarray(function(0, t, x, u, {**theta, "states": others}))

        return jax.vmap(one)(theta["states"])

    def __call__(self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta) -> Scalar:
        return jnp.sum(theta["weights"] * self.each(self.function, t, x, u, theta))


@dataclass(frozen=True)
class _ExpectedComposite(_Expected):
    def residual(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "_"]:
        return self.each(self.function.residual, t, x, u, theta).ravel()

    def loss(self, value: Float[Array, "_"], theta: Theta) -> Scalar:
        values = value.reshape(len(theta["weights"]), -1)
        return jnp.sum(
            theta["weights"] * jax.vmap(lambda one: self.function.loss(one, theta))(values)
        )


@dataclass(frozen=True)
class _Rows(_Expected):
    """Rows of a constraint under every hypothesis; where violations are priced, so are they."""

    def __call__(
        self, i: int, t: StageNumber, x: States, u: Controls, theta: Theta
    ) -> Float[Array, "_"]:
        rows = self.each(self.function, t, x, u, theta).reshape(len(theta["weights"]), -1)
        return (theta["weights"][:, None] * rows).ravel()


@lru_cache(maxsize=64)
def expected_response_game(game: Game, ego: int, count: int) -> Game:
    """Return the ego's problem, a game of one; `expected_response_parameters` makes its `theta`.

    Args:
        game: of all players, over as many stages as the plan has.
        ego: the player.
        count: number of hypotheses.

    Raises:
        ValueError: the player has equality constraints.
    """
    alone = best_response_game(game, ego)
    player = alone.players[0]
    if player.equalities:
        raise ValueError("game: has equality constraints, which differ between hypotheses")

    def expected(cost: Any) -> Any:
        return (_ExpectedComposite if isinstance(cost, Composite) else _Expected)(cost)

    single = replace(
        player,
        costs=tuple(expected(c) for c in player.costs),
        undiscounted_costs=tuple(expected(c) for c in player.undiscounted_costs),
        inequalities=tuple(
            Inequality(_Rows(c.function), count * c.size, c.penalty) for c in player.inequalities
        ),
        extra_theta=(*player.extra_theta, "weights"),
    )
    return replace(alone, players=(single,))


def expected_response_parameters(
    game: Game,
    ego: int,
    own: Theta,
    hypotheses: Sequence[Mapping[int, Float[np.ndarray, "T _"]]],
    weights: Float[np.ndarray, "count"],
) -> dict[str, Any]:
    """Return `theta` of `expected_response_game`.

    Args:
        game: of all players, over T stages.
        ego: the player.
        own: its parameters in that game.
        hypotheses: each the others' states after stages 1..T, by player.
        weights: of the hypotheses, above 0.
    """
    each = [best_response_parameters(game, ego, own, others) for others in hypotheses]
    states = {
        name: np.stack([theta["states"][name] for theta in each]) for name in each[0]["states"]
    }
    return {**each[0], "states": states, "weights": np.asarray(weights, dtype=float)}
