"""The intelligent driver model as a predictor: vehicles keep their path and their distance.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Physical Review E 62 (2000). Without a map a vehicle's lane is the circle that it is
on. The nearest agent ahead on it leads, be it a vehicle or a person. People keep their velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History, single
from agents.predictors.bodies import body_size, recent_turn, wanted_velocities
from foresight_env.games.arc import arc
from foresight_env.games.kinds import is_vehicle

SUBSTEP = 0.1
"""Longest time step of the integration, s."""
SIGHT = 60.0
"""How far ahead of where it will be a leader is looked for, m."""
SPACING = 0.25
"""Between the points of a lane at which leaders are looked for, m."""
BESIDE = 0.3
"""Free width on either side of a vehicle that belongs to its lane, m."""
STANDING = 0.3
"""A slower vehicle stays: it has no speed to go back to, m/s."""
NEAREST = 0.1
"""Smallest gap that the model divides by, m."""


@dataclass(frozen=True)
class IdmPredictor:
    """Vehicles follow their lane and the agent ahead on it; parameters for streets of a town."""

    name: str = "idm"
    time_gap: float = 1.5
    """To the leader, s (the paper's T)."""
    standing_gap: float = 2.0
    """To a leader that stands, m (s0)."""
    acceleration: float = 1.0
    """Largest, m/s^2 (a)."""
    braking: float = 2.0
    """Comfortable, m/s^2 (b)."""
    hardest: float = 6.0
    """Hardest braking, m/s^2: the model itself knows no limit."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        count = len(history.kinds)
        driving = [is_vehicle(kind) for kind in history.kinds]
        sizes = [body_size(history, i) for i in range(count)]
        parts = max(1, int(np.ceil(history.dt / SUBSTEP)))
        dt = history.dt / parts
        places, wanted = wanted_velocities(history, steps * parts + 1, dt)
        velocities = wanted[0].copy()
        speeds = np.linalg.norm(velocities, axis=1)
        targets = np.linalg.norm(wanted[0], axis=1)
        # No agent accelerates.
        lengths = SIGHT + history.dt * steps * speeds
        lanes = [
            _lane(places[i], velocities[i], recent_turn(history, i), float(lengths[i]))
            if driving[i]
            else None
            for i in range(count)
        ]
        travelled = np.zeros(count)
        found = []
        for k in range(steps * parts):
            rates = np.zeros(count)
            for i, lane in enumerate(lanes):
                if lane is not None and targets[i] > STANDING:
                    leader = _leader(i, lane, travelled[i], places, velocities, sizes)
                    rates[i] = self._rate(float(speeds[i]), float(targets[i]), leader)
            for i, lane in enumerate(lanes):
                if lane is None:
                    places[i] = places[i] + dt * wanted[k, i]
                    continue
                before = speeds[i]
                speeds[i] = max(0.0, before + dt * rates[i])
                travelled[i] += 0.5 * dt * (before + speeds[i])
                places[i], direction = _on(lane, float(travelled[i]))
                velocities[i] = speeds[i] * direction
            if (k + 1) % parts == 0:
                found.append(places.copy())
        return single(np.stack(found))

    def _rate(self, speed: float, target: float, leader: tuple[float, float] | None) -> float:
        """Acceleration along the lane, m/s^2; `leader`: gap (m) and the leader's speed along it."""
        rate = self.acceleration * (1.0 - (speed / target) ** 4)
        if leader is not None:
            gap, ahead = leader
            closing = speed * (speed - ahead) / (2.0 * np.sqrt(self.acceleration * self.braking))
            wanted = self.standing_gap + max(0.0, speed * self.time_gap + closing)
            rate -= self.acceleration * (wanted / max(gap, NEAREST)) ** 2
        return max(rate, -self.hardest)


def _lane(
    place: Float[np.ndarray, "2"], velocity: Float[np.ndarray, "2"], turn: float, length: float
) -> Float[np.ndarray, "L 2"]:
    """Points `SPACING` apart on the circle that a vehicle is on, for `length` metres."""
    speed = float(np.hypot(*velocity))
    direction = velocity / speed if speed > 0.0 else np.array([1.0, 0.0])
    curvature = turn / speed if speed > STANDING else 0.0
    # At 1 m/s, seconds are metres.
    return place + arc(direction, curvature, SPACING * np.arange(round(length / SPACING) + 1))


def _on(
    lane: Float[np.ndarray, "L 2"], travelled: float
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The point of a lane at that length, and its direction there; straight on beyond its end."""
    k = min(int(travelled / SPACING), len(lane) - 2)
    direction = (lane[k + 1] - lane[k]) / np.linalg.norm(lane[k + 1] - lane[k])
    return lane[k] + (travelled - k * SPACING) * direction, direction


def _leader(
    agent: int,
    lane: Float[np.ndarray, "L 2"],
    travelled: float,
    places: Float[np.ndarray, "N 2"],
    velocities: Float[np.ndarray, "N 2"],
    sizes: list[tuple[float, float]],
) -> tuple[float, float] | None:
    """Gap (m) to the nearest body ahead on the lane and its speed along it (m/s), None if free."""
    best = None
    for j, (length, width) in enumerate(sizes):
        if j == agent:
            continue
        distance = np.linalg.norm(lane - places[j], axis=1)
        k = int(np.argmin(distance))
        ahead = k * SPACING - travelled
        if ahead <= 0.0 or distance[k] > 0.5 * (width + sizes[agent][1]) + BESIDE:
            continue
        gap = ahead - 0.5 * (length + sizes[agent][0])
        if best is None or gap < best[0]:
            best = gap, float(velocities[j] @ _on(lane, k * SPACING)[1])
    return best
