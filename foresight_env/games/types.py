"""Array and PyTree types shared by the whole library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

Scalar = Float[Array, ""]
"""A real number as a JAX scalar."""

AnyArray = jax.Array | np.ndarray
"""Arrays at the interface: NumPy from concrete calls, JAX in calls that are themselves traced."""

StageNumber = Int[Array, ""] | int
"""Stage `t` in 1..T."""

States = tuple[Float[Array, "_"], ...]
"""One state vector per player; players may have different sizes."""

Controls = tuple[Float[Array, "_"], ...]
"""One control vector per player."""

Theta = Mapping[str, Any]
"""One player's cost parameters by name: a PyTree of arrays."""

CostFunction = Callable[[int, StageNumber, States, Controls, Theta], Scalar]
"""`cost(i, t, x, u, theta)`: what player `i` pays at stage `t` for the controls `u` of that stage
and for the states `x` that they lead to, given player `i`'s own `theta`."""

ConstraintFunction = Callable[[int, StageNumber, States, Controls, Theta], Float[Array, "*size"]]
"""`g(i, t, x, u, theta)`: a vector (or a scalar, for one row), satisfied when `g >= 0` (or `g == 0`
for equalities)."""

SharedConstraintFunction = Callable[
    [StageNumber, States, Controls, tuple[Theta, ...]], Float[Array, "*size"]
]
"""`g(t, x, u, thetas)`: a vector (or a scalar, for one row), satisfied when `g >= 0`, given every
player's `theta`."""
