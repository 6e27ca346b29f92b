"""Which parameters are estimated, as one vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.kkt import Parameters
from foresight_env.equilibrium.layout import Layout

GAMMA_BOUNDS = (0.0, 1.5)
"""Range of an estimated discount factor. The paper projects onto [0, infinity); weights of
`1.5**t` already leave nothing but the last stages."""


@dataclass(frozen=True)
class Free:
    """What is estimated of one player; everything else stays as given."""

    theta: tuple[str, ...] = ("goal",)
    """Entries of the player's `theta`."""
    gamma: bool = True
    initial_state: bool = False


@dataclass(frozen=True)
class Coordinates:
    """The free entries of `Parameters`, in order: per player `theta`, `gamma`, initial state."""

    layout: Layout
    free: tuple[Free, ...]
    sizes: tuple[tuple[tuple[str, tuple[int, ...]], ...], ...]
    """Per player, names and shapes of its free entries of `theta`."""

    @staticmethod
    def of(layout: Layout, free: Free | Sequence[Free], parameters: Parameters) -> Coordinates:
        """Check `free` against the game and its parameters."""
        count = len(layout.game.players)
        each = (free,) * count if isinstance(free, Free) else tuple(free)
        if len(each) != count:
            raise ValueError(f"free: has {len(each)} entries; expected one per player, {count}")
        sizes = []
        for i, f in enumerate(each):
            for name in f.theta:
                if name not in parameters.theta[i]:
                    raise ValueError(
                        f"free[{i}].theta: names {name!r}; player {i} has "
                        f"{sorted(parameters.theta[i])}"
                    )
            sizes.append(tuple((n, tuple(np.shape(parameters.theta[i][n]))) for n in f.theta))
        return Coordinates(layout, each, tuple(sizes))

    def pack(self, parameters: Parameters) -> Float[Array, "p"]:
        """The free entries of `parameters`."""
        parts = [jnp.zeros(0)]
        for i, f in enumerate(self.free):
            parts += [jnp.ravel(parameters.theta[i][name]) for name in f.theta]
            if f.gamma:
                parts.append(parameters.gamma[i : i + 1])
            if f.initial_state:
                parts.append(parameters.x0[self.layout.state_slices[i]])
        return jnp.concatenate(parts)

    def unpack(self, values: Float[Array, "p"], parameters: Parameters) -> Parameters:
        """`parameters` with its free entries replaced."""
        theta = [dict(t) for t in parameters.theta]
        gamma, x0 = jnp.asarray(parameters.gamma), jnp.asarray(parameters.x0)
        at = 0
        for i, f in enumerate(self.free):
            for name, shape in self.sizes[i]:
                size = int(np.prod(shape, dtype=int))
                theta[i][name] = values[at : at + size].reshape(shape)
                at += size
            if f.gamma:
                gamma = gamma.at[i].set(values[at])
                at += 1
            if f.initial_state:
                where = self.layout.state_slices[i]
                size = where.stop - where.start
                x0 = x0.at[where].set(values[at : at + size])
                at += size
        return Parameters(x0, tuple(theta), gamma)

    @property
    def names(self) -> tuple[str, ...]:
        """One name per entry, such as `goal[0] of 1`, `gamma of 0`, `x0[2] of 1`."""
        out: list[str] = []
        for i, f in enumerate(self.free):
            for name, shape in self.sizes[i]:
                size = int(np.prod(shape, dtype=int))
                out += [f"{name}[{k}] of {i}" if shape else f"{name} of {i}" for k in range(size)]
            if f.gamma:
                out.append(f"gamma of {i}")
            if f.initial_state:
                out += [f"x0[{k}] of {i}" for k in range(self.layout.game.state_sizes[i])]
        return tuple(out)

    @property
    def is_gamma(self) -> np.ndarray:
        """(p,) which entries are discount factors."""
        return np.array([n.startswith("gamma of ") for n in self.names], dtype=bool)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(p,) lower and upper limits: discount factors, and initial states in state bounds."""
        low = np.full(len(self.names), -np.inf)
        high = np.full(len(self.names), np.inf)
        low[self.is_gamma], high[self.is_gamma] = GAMMA_BOUNDS
        lower, upper = self.layout.bounds
        at = 0
        for i, f in enumerate(self.free):
            at += sum(int(np.prod(shape, dtype=int)) for _, shape in self.sizes[i]) + f.gamma
            if f.initial_state:
                where = self.layout.state_slices[i]
                size = where.stop - where.start
                low[at : at + size] = lower[0, where]
                high[at : at + size] = upper[0, where]
                at += size
        return low, high
