"""Discounting functions `Gamma(t; gamma)`: how much a cost at stage t counts (paper, eq. 1).

Solvers never use `Gamma(t)` itself, which underflows (`0.5**25` is 3e-8), but the ratio
`Gamma(t + 1) / Gamma(t)`, in which first-order conditions can be written exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.types import Scalar


@runtime_checkable
class Discounting(Protocol):
    """A family of weights over stages, twice differentiable in `gamma`, with `Gamma(0) = 1`."""

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest `gamma` for which the weights make sense."""
        ...

    def weight(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        """`Gamma(t; gamma) > 0`, dimensionless."""
        ...

    def ratio(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        """`Gamma(t + 1; gamma) / Gamma(t; gamma)`, computed without forming either."""
        ...


@dataclass(frozen=True)
class Exponential:
    """`Gamma(t) = gamma**t` (paper, section III-A). `gamma -> 0` is myopic, `gamma > 1` allowed."""

    limits: ClassVar[tuple[float, float]] = (0.0, math.inf)

    def weight(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return gamma**t

    def ratio(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return gamma


@dataclass(frozen=True)
class ExponentialPerSecond:
    """`Gamma(t) = gamma**(t dt)`: the discount factor per second, whatever the step's length.

    `gamma = 0.5` halves the weight of a cost with every second. `dt`: s per stage.
    """

    dt: float

    limits: ClassVar[tuple[float, float]] = (1e-6, math.inf)

    def weight(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return gamma ** (t * self.dt)

    def ratio(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return gamma**self.dt


@dataclass(frozen=True)
class Hyperbolic:
    """`Gamma(t) = 1 / (1 + k t)` with `k = 1/gamma - 1`: people's discounting as psychology has it.

    Parametrised so that `gamma = 1` discounts nothing and `Gamma(1) = gamma`, as for
    `Exponential`; 0 < gamma <= 1. Source: Mazur, "An adjusting procedure for studying delayed
    reinforcement" (1987), eq. 1.
    """

    limits: ClassVar[tuple[float, float]] = (1e-3, 1.0)

    def weight(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return gamma / (gamma + (1.0 - gamma) * t)

    def ratio(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return (gamma + (1.0 - gamma) * t) / (gamma + (1.0 - gamma) * (t + 1.0))


@dataclass(frozen=True)
class CustomDiscounting:
    """Any twice-differentiable `log Gamma(t; gamma)` given as a function `log_weight(t, gamma)`.

    The logarithm is asked for because it does not underflow; what it is at t = 0 is taken off, so
    that `Gamma(0) = 1`. `limits`: smallest and largest `gamma` that the function is meant for.
    """

    log_weight: Callable[[Float[Array, ""], Scalar], Scalar]
    limits: tuple[float, float] = (0.0, math.inf)

    def weight(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return jnp.exp(self.log_weight(t, gamma) - self.log_weight(jnp.zeros_like(t), gamma))

    def ratio(self, t: Float[Array, ""], gamma: Scalar) -> Scalar:
        return jnp.exp(self.log_weight(t + 1.0, gamma) - self.log_weight(t, gamma))
