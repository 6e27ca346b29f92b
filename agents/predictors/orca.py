"""Optimal reciprocal collision avoidance as a predictor.

Van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009): each agent
takes the velocity nearest to its preferred one that, if all do their half, keeps it clear of the
others for a while. Its velocities are one per step and it has no uncertainty. The packages that
bind the authors' program bring a robot simulator with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from agents.interfaces.predictor import Forecast, History, single
from agents.predictors.bodies import body_radius, wanted_velocities

SUBSTEP = 0.2
"""Longest time for which a velocity is kept, s."""
SLACK = 1e-9
"""By how much (m/s) a velocity may break a limit: rounding."""

HalfPlane = tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]
"""A point on its edge, and the unit normal into it: velocities, m/s."""


@dataclass(frozen=True)
class OrcaPredictor:
    """People and vehicles as discs that each do half of the avoidance."""

    name: str = "orca"
    time_horizon: float = 2.0
    """For how long the way must be clear, s."""
    faster: float = 1.3
    """The fastest that an agent would go, as a multiple of the speed that it wants."""

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast."""
        count = len(history.kinds)
        parts = max(1, int(np.ceil(history.dt / SUBSTEP)))
        dt = history.dt / parts
        radii = np.array([body_radius(history, i) for i in range(count)])
        places, wanted = wanted_velocities(history, steps * parts + 1, dt)
        velocities = wanted[0]
        limits = self.faster * np.linalg.norm(wanted[0], axis=1)
        found = []
        for k in range(steps * parts):
            new = np.empty_like(velocities)
            for i in range(count):
                planes = [
                    half_plane(
                        places[j] - places[i],
                        velocities[i],
                        velocities[j],
                        float(radii[i] + radii[j]),
                        self.time_horizon,
                        dt,
                    )
                    for j in range(count)
                    if j != i
                ]
                new[i] = nearest_velocity(planes, wanted[k, i], float(limits[i]))
            velocities = new
            places = places + dt * velocities
            if (k + 1) % parts == 0:
                found.append(places)
        return single(np.stack(found))


def half_plane(
    away: Float[np.ndarray, "2"],
    own: Float[np.ndarray, "2"],
    other: Float[np.ndarray, "2"],
    radius: float,
    horizon: float,
    dt: float,
) -> HalfPlane:
    """Velocities that do half of what keeps two discs apart for `horizon` seconds.

    `away`: from the own centre to the other's, m; `radius`: the sum of both. Discs that overlap are
    to be apart after `dt`.
    """
    relative = own - other
    distance = float(np.linalg.norm(away))
    if distance <= radius:
        horizon = dt
    # The forbidden relative velocities are a cone with a round tip, a disc about `away / horizon`.
    from_tip = relative - away / horizon
    length = float(np.linalg.norm(from_tip))
    if distance <= radius or (
        from_tip @ away < 0.0 and (from_tip @ away) ** 2 > radius**2 * length**2
    ):
        if length < SLACK:  # no side is given: step to the left
            from_tip, length = np.array([away[1], -away[0]]), max(distance, SLACK)
        normal = from_tip / length
        change = (radius / horizon - length) * normal
    else:
        leg = np.sqrt(distance**2 - radius**2)
        left = away[0] * relative[1] - away[1] * relative[0] > 0.0
        sign = 1.0 if left else -1.0
        along = (
            np.array(
                [
                    away[0] * leg - sign * away[1] * radius,
                    sign * away[0] * radius + away[1] * leg,
                ]
            )
            / distance**2
        )
        normal = sign * np.array([-along[1], along[0]])
        change = (relative @ along) * along - relative
    return own + 0.5 * change, normal


def nearest_velocity(
    planes: list[HalfPlane], wanted: Float[np.ndarray, "2"], limit: float
) -> Float[np.ndarray, "2"]:
    """The velocity nearest to `wanted` in all half-planes and not faster than `limit`, m/s.

    It is `wanted` itself, or lies on one or two edges: all of these are tried. Where there is none,
    the one that violates the worst half-plane least.
    """
    speed = float(np.linalg.norm(wanted))
    candidates = [wanted * min(1.0, limit / speed) if speed > 0.0 else wanted]
    for point, normal in planes:
        along = np.array([-normal[1], normal[0]])
        candidates.append(wanted + ((point - wanted) @ normal) * normal)
        across = point @ normal
        if abs(across) <= limit:
            reach = np.sqrt(limit**2 - across**2)
            candidates += [across * normal + reach * along, across * normal - reach * along]
    for (p, n), (q, m) in combinations(planes, 2):
        edges = np.stack([n, m])
        if abs(np.linalg.det(edges)) > SLACK:
            candidates.append(np.linalg.solve(edges, [p @ n, q @ m]))
    allowed = [
        v
        for v in candidates
        if v @ v <= (limit + SLACK) ** 2 and all((v - p) @ n >= -SLACK for p, n in planes)
    ]
    if not allowed:
        return _least_broken(planes, limit)
    return np.asarray(min(allowed, key=lambda v: float(np.sum((v - wanted) ** 2))))


EDGES = 16
"""Sides of the polygon that stands for the limit of speeds where no velocity is allowed."""


def _least_broken(planes: list[HalfPlane], limit: float) -> Float[np.ndarray, "2"]:
    """Of velocities up to `limit`, the one that violates the worst half-plane least."""
    angles = 2.0 * np.pi * np.arange(EDGES) / EDGES
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    normals = np.stack([n for _, n in planes])
    broken = np.column_stack([-normals, -np.ones(len(planes))])
    rows = np.vstack([broken, np.column_stack([around, np.zeros(EDGES)])])
    bounds = np.concatenate([[-(p @ n) for p, n in planes], np.full(EDGES, limit)])
    found = linprog([0.0, 0.0, 1.0], rows, bounds, bounds=[(None, None)] * 3)
    return np.asarray(found.x[:2])
