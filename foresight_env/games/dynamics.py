"""How one agent moves: `next_state = dynamics(t, state, control)`.

A dynamics is a hashable callable with `state_size`, `control_size` and `linear` (true when
`next_state` is affine in state and control, so that solvers may skip second derivatives). Units
are SI, angles are radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.types import StageNumber


@runtime_checkable
class Dynamics(Protocol):
    """What a game needs to know of one agent's motion."""

    @property
    def state_size(self) -> int: ...

    @property
    def control_size(self) -> int: ...

    @property
    def linear(self) -> bool: ...

    def __call__(
        self, t: StageNumber, state: Float[Array, "n"], control: Float[Array, "m"]
    ) -> Float[Array, "n"]: ...


@dataclass(frozen=True)
class DoubleIntegrator:
    """Point mass in the plane, exact under a control held constant over `dt` (paper, section VI-A).

    State `[px, py, vx, vy]` (m, m/s), control `[ax, ay]` (m/s^2).
    """

    dt: float

    state_size: int = 4
    control_size: int = 2
    linear: bool = True

    def __call__(
        self, t: StageNumber, state: Float[Array, "4"], control: Float[Array, "2"]
    ) -> Float[Array, "4"]:
        position, velocity = state[:2], state[2:]
        return jnp.concatenate(
            [
                position + self.dt * velocity + 0.5 * self.dt**2 * control,
                velocity + self.dt * control,
            ]
        )


@dataclass(frozen=True)
class KinematicBicycle:
    """Car with its rear axle as reference point, forward Euler as in the paper (section VI-B).

    State `[px, py, v, psi]` (m, m/s, rad), control `[a, phi]`: longitudinal acceleration (m/s^2)
    and steering angle (rad). `wheelbase` is in metres.
    """

    dt: float
    wheelbase: float = 1.0

    state_size: int = 4
    control_size: int = 2
    linear: bool = False

    def __call__(
        self, t: StageNumber, state: Float[Array, "4"], control: Float[Array, "2"]
    ) -> Float[Array, "4"]:
        _, _, speed, heading = state
        acceleration, steering = control
        rate = jnp.stack(
            [
                speed * jnp.cos(heading),
                speed * jnp.sin(heading),
                acceleration,
                speed * jnp.tan(steering) / self.wheelbase,
            ]
        )
        return state + self.dt * rate
