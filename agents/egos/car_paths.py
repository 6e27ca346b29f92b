"""Motion of a car along a path that it may leave by a swerve, without solving a game."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foresight_env.games import Dynamics
from foresight_env.precision import in_double_precision

LEAST_SPACING = 0.2
"""Least distance between points of a path, m: closer ones give no direction."""
OFF_PATH = (0.25, 0.1)
"""Distance (m) and angle (rad) from a path beyond which a car is not on it."""
STRAIGHT_ON = 200.0
"""Length by which a path is extended, m."""
ARC_LENGTH = 40
"""Length of the arc that a steering angle leads along, m."""
SWERVE_SPACING = 1.0
"""Distance between points of a swerve, m."""
ANGLES = 25
"""Steering angles of which the curvature is computed, to be interpolated."""
LEAST_ACCELERATION = 1e-9
"""Below it a speed counts as constant, m/s^2."""


def path_ahead(
    pose: Float[np.ndarray, "3"],
    planned: Float[np.ndarray, "K 2"],
    route: Float[np.ndarray, "P 3"] | None,
) -> Float[np.ndarray, "L 4"]:
    """Path of a car from its pose: its plan, then parallel to its route, then straight on.

    Args:
        pose: present `[px, py, heading]`, m and rad.
        planned: (K, 2) planned positions, m; may be empty.
        route: (P, 3) poses along the route; None where there is none.

    Returns:
        Points `[distance along the path, px, py, heading]`, m and rad.
    """
    points, direction = [pose[:2]], np.array([np.cos(pose[2]), np.sin(pose[2])])
    ahead = planned
    if route is not None:
        last = planned[-1] if len(planned) else pose[:2]
        ahead = np.concatenate([planned, _parallel(route, last)])
    for point in ahead:
        step = point - points[-1]
        # No points behind: noise moves the pose against the direction of travel.
        if np.hypot(*step) >= LEAST_SPACING and step @ direction > 0.0:
            points.append(point)
            direction = step / np.hypot(*step)
    points.append(points[-1] + STRAIGHT_ON * direction)
    places = np.stack(points)
    steps = np.diff(places, axis=0)
    headings = np.unwrap(np.concatenate([pose[2:], np.arctan2(steps[:, 1], steps[:, 0])]))
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    return np.column_stack([lengths, places, headings])


def _parallel(
    route: Float[np.ndarray, "P 3"], place: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "L 2"]:
    """The route's points after the place, moved sideways by the place's offset from it."""
    nearest = int(np.argmin(np.sum((route[:, :2] - place) ** 2, axis=1)))
    x, y, heading = route[nearest]
    offset = np.cos(heading) * (place[1] - y) - np.sin(heading) * (place[0] - x)
    later = route[nearest + 1 :]
    left = np.stack([-np.sin(later[:, 2]), np.cos(later[:, 2])], axis=1)
    found: Float[np.ndarray, "L 2"] = later[:, :2] + offset * left
    return found


def along(
    path: Float[np.ndarray, "L 4"], covered: Float[np.ndarray, "M T"]
) -> Float[np.ndarray, "M T 3"]:
    """Poses after so many m along a path (`path_ahead`)."""
    return np.stack([np.interp(covered, path[:, 0], path[:, k]) for k in (1, 2, 3)], axis=2)


def is_on(path: Float[np.ndarray, "L 4"], pose: Float[np.ndarray, "3"]) -> bool:
    """Whether a car at the pose is on the path (`path_ahead`) and heads along it."""
    pieces = np.diff(path[:, 1:3], axis=0)
    away = pose[:2] - path[:-1, 1:3]
    part = np.clip(np.sum(away * pieces, axis=1) / np.sum(pieces**2, axis=1), 0.0, 1.0)
    distance = np.hypot(*(away - part[:, None] * pieces).T)
    nearest = int(np.argmin(distance))
    turn = pose[2] - np.arctan2(pieces[nearest, 1], pieces[nearest, 0])
    turn = np.mod(turn + np.pi, 2.0 * np.pi) - np.pi
    return bool(distance[nearest] <= OFF_PATH[0] and abs(turn) <= OFF_PATH[1])


def swerved(
    path: Float[np.ndarray, "L 4"], offset: float, begin: float, length: float
) -> Float[np.ndarray, "K 4"]:
    """Path that leaves another by `offset` m to the left, after `begin` m and within `length` m.

    The offset is a cubic with level ends.
    """
    if offset == 0.0:
        return path
    grid = np.arange(0.0, begin + length + SWERVE_SPACING, SWERVE_SPACING)
    covered = np.concatenate([grid, path[path[:, 0] > grid[-1], 0]])
    poses = along(path, covered[None])[0]
    part = np.clip((covered - begin) / length, 0.0, 1.0)
    aside = offset * part**2 * (3.0 - 2.0 * part)
    left = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=1)
    places = poses[:, :2] + aside[:, None] * left
    headings = poses[:, 2] + np.arctan(6.0 * offset * part * (1.0 - part) / length)
    steps = np.hypot(*np.diff(places, axis=0).T)
    return np.column_stack([np.concatenate([[0.0], np.cumsum(steps)]), places, headings])


def covered_distance(
    speed: float,
    accelerations: Float[np.ndarray, "M"],
    fastest: float,
    times: Float[np.ndarray, "T"],
) -> Float[np.ndarray, "M T"]:
    """Distance (m) that a car covers with each acceleration (m/s^2), until rest or `fastest` (m/s).

    Cars do not reverse.
    """
    changing = np.abs(accelerations) > LEAST_ACCELERATION
    rate = np.where(changing, accelerations, 1.0)
    final = np.where(changing, np.where(rate > 0.0, max(fastest, speed), 0.0), speed)
    final = np.where(np.isfinite(final), final, np.finfo(float).max)
    until = np.where(changing, (final - speed) / rate, np.inf)[:, None]
    during = np.minimum(times, until)
    found: Float[np.ndarray, "M T"] = (
        speed * during
        + 0.5 * accelerations[:, None] * during**2
        # No time is left where a speed never ends.
        + np.where(times > until, final[:, None] * (times - during), 0.0)
    )
    return found


def arc_ahead(
    dynamics: Dynamics, state: Float[np.ndarray, "4"], steering: float
) -> Float[np.ndarray, "K 2"]:
    """Positions, a metre apart, of a vehicle `[px, py, v, psi]` that keeps its second control."""
    slip, curvature = (float(v[0]) for v in _arcs(dynamics, np.array([steering])))
    # Headings in the middle of each metre.
    headings = state[3] + slip + curvature * (np.arange(ARC_LENGTH) + 0.5)
    steps = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    return np.asarray(state[:2] + np.cumsum(steps, axis=0))


def pursuit(
    dynamics: Dynamics,
    state: Float[np.ndarray, "4"],
    target: Float[np.ndarray, "2"],
    limits: tuple[float, float],
) -> float:
    """Steering of a vehicle `[px, py, v, psi]` towards a place ahead, within its limits.

    Pure pursuit (Coulter, CMU-RI-TR-92-01, 1992): of the arcs that the vehicle's dynamics can
    follow from its pose, the one that passes the place. Its second control steers.
    """
    angles = np.linspace(*limits, ANGLES)
    slip, curvature = (np.asarray(values) for values in _arcs(dynamics, angles))
    away, heading = target - state[:2], state[3] + slip
    across = np.cos(heading) * away[1] - np.sin(heading) * away[0]
    squared = float(away @ away)
    # Offset of the place to the left of each arc (`games.paths.arc_offset`).
    root = np.sqrt(np.maximum(1.0 - 2.0 * curvature * across + curvature**2 * squared, 0.0))
    offset = (2.0 * across - curvature * squared) / (1.0 + root)
    return float(np.interp(0.0, offset[::-1], angles[::-1]))


@in_double_precision
@partial(jax.jit, static_argnums=0)
def _arcs(
    dynamics: Dynamics, angles: Float[Array, "K"]
) -> tuple[Float[Array, "K"], Float[Array, "K"]]:
    """Direction of travel against the heading (rad), and curvature (1/m), per second control."""
    start = jnp.array([0.0, 0.0, 1.0, 0.0])

    def arc(angle: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        after = dynamics(1, start, jnp.stack([jnp.zeros_like(angle), angle]))
        chord = jnp.arctan2(after[1], after[0])
        return chord, after[3] / jnp.hypot(after[0], after[1])

    return jax.vmap(arc)(angles)
