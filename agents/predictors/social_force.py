"""The social force model as a predictor.

Helbing and Molnar, "Social force model for pedestrian dynamics", Physical Review E 51 (1995):
people accelerate towards their preferred velocity, and away from others who would soon be near
them. Vehicles keep their speed and turn rate, and push people away as people do, from their
outline.
The packages that offer it bring Numba or a building simulator's graphics with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History, single
from agents.predictors.bodies import body_size, wanted_velocities
from foresight_env.games.kinds import is_vehicle

SUBSTEP = 0.05
"""Longest time step of the integration, s."""
VIEW = np.cos(np.deg2rad(100.0))
"""Cosine of half the angle of sight, 200 degrees in the paper."""
UNSEEN = 0.5
"""By how much a force from behind counts (the paper's c)."""
SMALL = 1e-6
"""Distances (m) below which there is no direction."""


@dataclass(frozen=True)
class SocialForcePredictor:
    """People make way for each other and for vehicles; the paper's parameters."""

    name: str = "social-force"
    relaxation: float = 0.5
    """Time in which people take up the velocity that they want, s."""
    strength: float = 2.1
    """Of the repulsion, m^2/s^2."""
    reach: float = 0.3
    """Of the repulsion, m."""
    stride: float = 2.0
    """Time in which the other's next step is counted with (the paper's delta t), s."""
    faster: float = 1.3
    """The fastest that people go, as a multiple of the speed that they want."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        parts = max(1, int(np.ceil(history.dt / SUBSTEP)))
        dt = history.dt / parts
        places, wanted = wanted_velocities(history, steps * parts + 1, dt)
        velocities = wanted[0]
        driving = np.array([is_vehicle(kind) for kind in history.kinds])
        sizes = [body_size(history, i) for i in range(len(driving))]
        limits = self.faster * np.linalg.norm(wanted[0], axis=1)
        found = []
        for k in range(steps * parts):
            pushed = np.stack(
                [
                    np.zeros(2) if driving[i] else self.push(i, places, velocities, sizes)
                    for i in range(len(driving))
                ]
            )
            pull = (wanted[k] - velocities) / self.relaxation
            walking = velocities + dt * (pull + pushed)
            speeds = np.maximum(np.linalg.norm(walking, axis=1), SMALL)
            walking *= np.minimum(1.0, limits / speeds)[:, None]
            velocities = np.where(driving[:, None], wanted[k + 1], walking)
            places = places + dt * velocities
            if (k + 1) % parts == 0:
                found.append(places)
        return single(np.stack(found))

    def push(
        self,
        agent: int,
        places: Float[np.ndarray, "N 2"],
        velocities: Float[np.ndarray, "N 2"],
        sizes: list[tuple[float, float]],
    ) -> Float[np.ndarray, "2"]:
        """Acceleration (m/s^2) that the others cause."""
        total = np.zeros(2)
        heading = velocities[agent]
        for j, (length, width) in enumerate(sizes):
            if j == agent:
                continue
            nearest = _nearest_on(places[j], velocities[j], 0.5 * (length - width), places[agent])
            away = places[agent] - nearest
            step = self.stride * velocities[j]
            ahead = away - step
            near, far = float(np.linalg.norm(away)), float(np.linalg.norm(ahead))
            if near < SMALL or far < SMALL:
                continue
            ellipse = near + far
            # Half the minor axis of an ellipse with focal points at the other and at its next step.
            b = 0.5 * np.sqrt(max(ellipse**2 - step @ step, SMALL))
            strength = self.strength / self.reach * np.exp(-b / self.reach)
            force = strength * ellipse / (4.0 * b) * (away / near + ahead / far)
            if heading @ -force < VIEW * np.linalg.norm(heading) * np.linalg.norm(force):
                force = UNSEEN * force
            total += force
        return total


def _nearest_on(
    middle: Float[np.ndarray, "2"],
    velocity: Float[np.ndarray, "2"],
    half: float,
    place: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """The point nearest to `place` of a body's middle line, which lies along its velocity."""
    speed = float(np.linalg.norm(velocity))
    if half <= 0.0 or speed < SMALL:
        return middle
    along = velocity / speed
    return np.asarray(middle + np.clip((place - middle) @ along, -half, half) * along)
