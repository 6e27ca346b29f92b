"""How one agent moves: `next_state = dynamics(t, state, control)`.

A dynamics is a hashable callable with `state_size`, `control_size` and `linear` (true when
`next_state` is affine in state and control, so that solvers may skip second derivatives). Units
are SI, angles are radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float

from foresight_env.games.types import StageNumber


@runtime_checkable
class Dynamics(Protocol):
    """Discrete-time motion of one agent."""

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


class Vehicle:
    """Dynamics of cars: a state that begins with `[px, py, v, psi]` (m, m/s, rad).

    Of most the state ends there, the first control is the acceleration along the heading (m/s^2),
    and the second steers.
    """

    state_size: ClassVar[int] = 4
    control_size: ClassVar[int] = 2
    linear: ClassVar[bool] = False


@dataclass(frozen=True)
class KinematicBicycle(Vehicle):
    """Car with its rear axle as reference point, forward Euler as in the paper (section VI-B).

    Its second control is the steering angle (rad). `wheelbase` is in metres.
    """

    dt: float
    wheelbase: float = 1.0

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


@dataclass(frozen=True)
class CurvatureVehicle(Vehicle):
    """Car steered by the curvature of its path, whatever its wheelbase; midpoint rule.

    Its second control is the curvature (1/m), positive to the left. With long steps, where forward
    Euler leaves the circle, it stays on it to second order.
    """

    dt: float

    def __call__(
        self, t: StageNumber, state: Float[Array, "4"], control: Float[Array, "2"]
    ) -> Float[Array, "4"]:
        _, _, speed, heading = state
        acceleration, curvature = control
        middle = speed + 0.5 * self.dt * acceleration
        turned = heading + 0.5 * self.dt * middle * curvature
        rate = jnp.stack(
            [
                middle * jnp.cos(turned),
                middle * jnp.sin(turned),
                acceleration,
                middle * curvature,
            ]
        )
        return state + self.dt * rate


@dataclass(frozen=True)
class SmoothVehicle(Vehicle):
    """Car whose acceleration and curvature change continuously; midpoint rule.

    State `[px, py, v, psi, a, kappa]` (m, m/s, rad, m/s^2, 1/m), control `[jerk, curvature rate]`
    (m/s^3, 1/(m s)). The curvature of the path stands for the steering angle `phi` of a car with
    wheelbase `l`: `kappa = tan(phi) / l`.
    """

    dt: float

    state_size: ClassVar[int] = 6

    def __call__(
        self, t: StageNumber, state: Float[Array, "6"], control: Float[Array, "2"]
    ) -> Float[Array, "6"]:
        _, _, speed, heading, acceleration, curvature = state
        jerk, curvature_rate = control
        half = 0.5 * self.dt
        middle_acceleration = acceleration + half * jerk
        middle_curvature = curvature + half * curvature_rate
        middle = speed + half * acceleration + 0.5 * half**2 * jerk
        turned = heading + half * middle * (curvature + 0.5 * half * curvature_rate)
        rate = jnp.stack(
            [
                middle * jnp.cos(turned),
                middle * jnp.sin(turned),
                middle_acceleration,
                middle * middle_curvature,
                jerk,
                curvature_rate,
            ]
        )
        return state + self.dt * rate


@dataclass(frozen=True)
class SlipBicycle(Vehicle):
    """The car of highway-env (`vehicle.kinematics.Vehicle`): position in the middle, slip angle.

    Polack, Altche, d'Andrea-Novel, de La Fortelle, "The kinematic bicycle model", IV 2017. Its
    second control is the steering angle (rad), positive to the left in axes whose y points up. The
    control is held over `dt`, which forward Euler passes in `substeps` equal steps, as a simulator
    does whose simulation frequency is that many times its policy frequency.
    """

    dt: float
    substeps: int = 1
    length: float = 5.0
    """Twice the distance from the middle to each axle, m."""

    def __call__(
        self, t: StageNumber, state: Float[Array, "4"], control: Float[Array, "2"]
    ) -> Float[Array, "4"]:
        acceleration, steering = control
        slip = jnp.arctan(0.5 * jnp.tan(steering))
        step = self.dt / self.substeps
        for _ in range(self.substeps):
            _, _, speed, heading = state
            rate = jnp.stack(
                [
                    speed * jnp.cos(heading + slip),
                    speed * jnp.sin(heading + slip),
                    acceleration,
                    speed * jnp.sin(slip) / (self.length / 2.0),
                ]
            )
            state = state + step * rate
        return state
