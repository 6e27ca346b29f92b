"""Vector of the parameters that may be estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.types import AnyArray
from foresight_env.inverse.parameter import Parameter
from foresight_env.precision import is_traced


@dataclass(frozen=True)
class Free:
    """Parameters of one player that are estimated; all others stay as given.

    Raises:
        ValueError: `theta` is no tuple, a range is empty or names an entry that is not estimated.
    """

    theta: tuple[str, ...] = ("goal",)
    """Entries of the player's `theta`."""
    gamma: bool = True
    """Whether its discount factor is."""
    initial_state: bool = False
    """Whether its state at the first observation is."""
    gamma_range: tuple[float, float] = (0.0, 1.0)
    """Limits of the estimated discount factor. The paper projects onto [0, infinity): give `(0,
    1.2)` where agents may weigh later costs more than present ones."""
    theta_range: tuple[tuple[str, tuple[float, float]], ...] = ()
    """Names of entries of `theta` with limits of their estimates, such as `(("lane_weight", (0.1,
    100.0)),)`; a limit may be infinite. Weights should be kept above 0."""

    def __post_init__(self) -> None:
        if isinstance(self.theta, str):
            raise ValueError(f"theta: is {self.theta!r}; expected a tuple: ({self.theta!r},)")
        low, high = self.gamma_range
        if not 0.0 <= low < high:
            raise ValueError(
                f"gamma_range: is {self.gamma_range}; expected (low, high), 0 <= low < high"
            )
        for name, limits in self.theta_range:
            if name not in self.theta:
                raise ValueError(f"theta_range: names {name!r}; estimated are {self.theta}")
            if not limits[0] < limits[1]:
                raise ValueError(f"theta_range: {name!r} has {limits}; expected (low, high)")


@dataclass(frozen=True)
class Coordinates:
    """All parameters that may be estimated, as one vector: per player `theta`, gamma, `x_1`.

    Which of them *are* estimated is a mask, known only at run time: the same compiled program
    serves the ego's estimator, the gamma = 1 baseline and a known initial state.
    """

    layout: Layout
    sizes: tuple[tuple[tuple[str, tuple[int, ...]], ...], ...]
    """Per player, names and shapes of its entries of `theta`."""

    @staticmethod
    def of(
        layout: Layout, free: Free | Sequence[Free], parameters: Parameters
    ) -> tuple[Coordinates, np.ndarray]:
        """The coordinates and the mask (p,) of free ones; checks `free` against the game."""
        count = len(layout.game.players)
        each = (free,) * count if isinstance(free, Free) else tuple(free)
        if len(each) != count:
            raise ValueError(f"free: has {len(each)} entries; expected one per player, {count}")
        for i, f in enumerate(each):
            for name in f.theta:
                if name in ("gamma", "initial_state"):
                    raise ValueError(
                        f"free[{i}].theta: {name!r} names a discount factor or an initial state in "
                        "estimates; rename that entry of theta"
                    )
                if name not in parameters.theta[i]:
                    raise ValueError(
                        f"free[{i}].theta: names {name!r}; player {i} has "
                        f"{sorted(parameters.theta[i])}"
                    )
        named = sorted({name for f in each for name in f.theta})
        sizes = tuple(
            tuple((name, tuple(np.shape(theta[name]))) for name in named if name in theta)
            for theta in parameters.theta
        )
        mask: list[bool] = []
        for i, f in enumerate(each):
            for name, shape in sizes[i]:
                mask += [name in f.theta] * _size(shape)
            mask += [f.gamma] + [f.initial_state] * layout.game.state_sizes[i]
        return Coordinates(layout, sizes), np.array(mask, dtype=bool)

    def pack(self, parameters: Parameters) -> Float[AnyArray, "p"]:
        """The entries of `parameters` in order."""
        xp: Any = jnp if is_traced(parameters) else np
        parts = []
        for i, names in enumerate(self.sizes):
            parts += [xp.ravel(xp.asarray(parameters.theta[i][name])) for name, _ in names]
            own = self.layout.state_slices[i]
            parts += [
                xp.asarray(parameters.gamma[i : i + 1]),
                xp.asarray(parameters.initial_state[own]),
            ]
        return xp.concatenate(parts)

    def unpack(self, values: Float[Array, "p"], parameters: Parameters) -> Parameters:
        """`parameters` with these entries replaced."""
        theta = [dict(t) for t in parameters.theta]
        gammas, states = [], []
        at = 0
        for i, names in enumerate(self.sizes):
            for name, shape in names:
                theta[i][name] = values[at : at + _size(shape)].reshape(shape)
                at += _size(shape)
            gammas.append(values[at])
            size = self.layout.game.state_sizes[i]
            states.append(values[at + 1 : at + 1 + size])
            at += 1 + size
        return Parameters(jnp.concatenate(states), tuple(theta), jnp.stack(gammas))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Identity of every entry, in order."""
        out: list[Parameter] = []
        for i, names in enumerate(self.sizes):
            for name, shape in names:
                places = range(_size(shape)) if shape else (None,)
                out += [Parameter(i, "theta", name, k) for k in places]
            out.append(Parameter(i, "gamma"))
            states = range(self.layout.game.state_sizes[i])
            out += [Parameter(i, "initial_state", index=k) for k in states]
        return tuple(out)

    @property
    def is_gamma(self) -> np.ndarray:
        """(p,) which entries are discount factors."""
        return np.asarray(self.kinds == "gamma")

    @property
    def kinds(self) -> np.ndarray:
        """(p,) kind of each entry: "gamma", "initial_state", or "theta"."""
        return np.array([parameter.kind for parameter in self.parameters])

    def limits(
        self, free: Free | Sequence[Free], estimated: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(p,) lower and upper limits: as `free` has them, of initial states by state bounds.

        Parameters that are not `estimated` (p,) have none.
        """
        players = self.layout.game.players
        each = (free,) * len(players) if isinstance(free, Free) else tuple(free)
        kinds = self.kinds
        low, high = np.full(kinds.size, -np.inf), np.full(kinds.size, np.inf)
        families = np.array([p.discounting.limits for p in players])
        ranges = np.array([f.gamma_range for f in each])
        low[self.is_gamma] = np.maximum(families[:, 0], ranges[:, 0])
        high[self.is_gamma] = np.minimum(families[:, 1], ranges[:, 1])
        for i, (least, most) in enumerate(
            zip(low[self.is_gamma], high[self.is_gamma], strict=True)
        ):
            if each[i].gamma and least >= most:
                raise ValueError(
                    f"free[{i}].gamma_range: is {each[i].gamma_range}; player {i}'s discounting "
                    f"has gamma in {players[i].discounting.limits}"
                )
        ranges_of = [dict(f.theta_range) for f in each]
        at = 0
        for i, names in enumerate(self.sizes):
            for name, shape in names:
                if name in ranges_of[i]:
                    own = slice(at, at + _size(shape))
                    low[own], high[own] = ranges_of[i][name]
                at += _size(shape)
            at += 1 + self.layout.game.state_sizes[i]
        is_state = kinds == "initial_state"
        lower, upper = self.layout.bounds
        low[is_state], high[is_state] = lower[0, : self.layout.n], upper[0, : self.layout.n]
        return np.where(estimated, low, -np.inf), np.where(estimated, high, np.inf)


def _size(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=int))
