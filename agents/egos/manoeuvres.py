"""Evasive manoeuvres of an ego: what it can do from now on, and after a given first action.

Walkers change their velocity and keep it. Cars choose an acceleration along their planned path, and
may swerve from it. Times are a grid from now on (s). A pose is `[px, py, heading]` (m, rad);
walkers' headings are 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.car_paths import (
    along,
    arc_ahead,
    covered_distance,
    is_on,
    path_ahead,
    pursuit,
    swerved,
)
from agents.interfaces.policy import Decision
from foresight_env.envs.core.scene import Scene
from foresight_env.games import Bounds, Vehicle
from foresight_env.games.kinds import PEDESTRIAN

DIRECTIONS = 16
"""Evenly spaced, in which a walker may evade."""
USUAL_LIMITS = np.array([5.0, 0.6])
"""Limits of acceleration (m/s^2) and steering (rad) of cars whose game has none."""
LEVELS = 5
"""Accelerations of a car, evenly spaced between its limits."""
SWERVES = (0.0, 1.5, -1.5)
"""Lateral offsets (m) by which a car may leave its planned path; the first is none."""
SWERVE_TIME, LEAST_SWERVE = 1.5, 8.0
"""Seconds, but at least m, that a swerve takes: at most 4 m/s^2 of lateral acceleration."""
SWERVE_MARGIN = 0.2
"""Clearance that a swerve needs in addition, m: pure pursuit cuts its bends."""
AIM_TIME, LEAST_AIM = 0.6, 4.0
"""Seconds, but at least m, ahead of the place that a swerving car steers to."""


Backup = Float[np.ndarray, "_ 4"] | None
"""Path (`path_ahead`) of a car's evasive manoeuvre, which its later decisions may continue: those
along their plan change with the plan. Walkers' manoeuvres are the same at every decision."""


class Motions(NamedTuple):
    """Possible motions of the ego at the times of a grid."""

    poses: Float[np.ndarray, "M T 3"]
    """`[px, py, heading]`, m and rad."""
    margin: Float[np.ndarray, "M"]
    """Additional clearance of each motion that is not followed exactly, m."""
    backups: tuple[Backup, ...]
    """Path of each motion, for the next decision."""


class Manoeuvres(NamedTuple):
    """Evasive manoeuvres of the ego."""

    controls: Float[np.ndarray, "M m"]
    """First controls of the manoeuvres that begin now."""
    now: Motions
    """The M manoeuvres that begin now."""
    later: Motions
    """Manoeuvres that begin after a step with the decision's action; one continues the action."""


def manoeuvres(
    scene: Scene,
    ego: int,
    state: Float[np.ndarray, "4"],
    decision: Decision,
    times: Float[np.ndarray, "T"],
    backup: Backup,
) -> Manoeuvres:
    """Return the manoeuvres of an ego that walks or drives.

    Args:
        scene: with the ego's dynamics, limits and route.
        ego: the player.
        state: present state, `[px, py, vx, vy]` or `[px, py, v, psi]` (m, m/s, rad).
        decision: whose action may be taken first, and whose plan a car follows.
        times: from now on, s.
        backup: of the manoeuvre by which the last decision was found to be safe, if any.
    """
    if isinstance(scene.game.players[ego].dynamics, Vehicle):
        return _driving(scene, ego, state, decision, times, backup)
    return _walking(scene, ego, state, decision, times)


def limits(box: Bounds | None, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits at the first stage; infinite without a box."""
    if box is None:
        return np.full(size, -np.inf), np.full(size, np.inf)
    return np.asarray(box.lower[0]), np.asarray(box.upper[0])


def _walking(
    scene: Scene,
    ego: int,
    state: Float[np.ndarray, "4"],
    decision: Decision,
    times: Float[np.ndarray, "T"],
) -> Manoeuvres:
    player, dt = scene.game.players[ego], scene.dt
    strongest = limits(player.control_bounds, 2)[1]
    low, high = limits(player.state_bounds, 4)
    targets = velocities(low[2:], high[2:])
    controls, now = walk(state, targets, strongest, times, dt)
    after = np.clip(state[2:] + dt * decision.action.astype(float), low[2:], high[2:])
    first = times <= dt
    _, begin = walk(state, after[None], strongest, times[first], dt)
    moved = np.concatenate([state[:2] + 0.5 * dt * (state[2:] + after), after])
    ends = np.concatenate([targets, after[None]])
    _, end = walk(moved, ends, strongest, times[~first] - dt, dt)
    begin = np.broadcast_to(begin, (len(ends), *begin.shape[1:]))
    later = np.concatenate([begin, end], axis=1)
    exact = [Motions(poses, np.zeros(len(poses)), (None,) * len(poses)) for poses in (now, later)]
    return Manoeuvres(controls, *exact)


def walk(
    state: Float[np.ndarray, "4"],
    targets: Float[np.ndarray, "M 2"],
    acceleration: Float[np.ndarray, "2"],
    times: Float[np.ndarray, "T"],
    dt: float,
) -> tuple[Float[np.ndarray, "M 2"], Float[np.ndarray, "M T 3"]]:
    """First controls and poses of a walker that changes its velocity to each target (m/s).

    A change takes a step of `dt` at least, longer where the acceleration limit (m/s^2, per axis)
    requires it.
    """
    change = targets - state[2:]
    ramp = np.maximum(np.abs(change) / acceleration, dt)
    rate = change / ramp
    during = np.minimum(times[:, None], ramp[:, None])
    after = times[:, None] - during
    places = state[:2] + state[2:] * during + 0.5 * rate[:, None] * during**2
    places += targets[:, None] * after
    return rate, np.concatenate([places, np.zeros((*places.shape[:2], 1))], axis=2)


def velocities(
    lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "M 2"]:
    """Velocities that a walker may evade with: rest, and the fastest in every direction (m/s).

    At most a pedestrian's usual limit, where the game has none.
    """
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    away = np.round(np.stack([np.cos(angles), np.sin(angles)], axis=1), 12)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(away > 0.0, upper / away, np.where(away < 0.0, lower / away, np.inf))
    speeds = np.minimum(reach.min(axis=1), PEDESTRIAN.speed_limit)
    return np.concatenate([np.zeros((1, 2)), away * speeds[:, None]])


def _driving(
    scene: Scene,
    ego: int,
    state: Float[np.ndarray, "4"],
    decision: Decision,
    times: Float[np.ndarray, "T"],
    backup: Backup,
) -> Manoeuvres:
    player, dt = scene.game.players[ego], scene.dt
    action = decision.action.astype(float)
    low, high = (
        np.where(np.isfinite(found), found, sign * USUAL_LIMITS)
        for sign, found in zip((-1.0, 1.0), limits(player.control_bounds, 2), strict=True)
    )
    fastest = float(limits(player.state_bounds, 4)[1][2])
    pose, route = state[[0, 1, 3]], scene.own(ego).theta.get("path")
    speed = max(float(state[2]), 0.0)
    if decision.planned is None:
        ahead, beyond = arc_ahead(player.dynamics, state, float(action[1])), None
    else:
        ahead, beyond = decision.planned, None if route is None else route[:, :3]
    planned = path_ahead(pose, ahead, beyond)
    after = float(np.clip(speed + dt * action[0], 0.0, fastest))
    step = 0.5 * dt * (speed + after)
    length = max(SWERVE_TIME * speed, LEAST_SWERVE)
    # An ego without a plan may never begin a swerve.
    swerves = SWERVES if decision.planned is not None else SWERVES[:1]
    paths = [swerved(planned, offset, step, length) for offset in swerves]
    if backup is not None and is_on(backup, pose):
        paths.append(path_ahead(pose, backup[:-1, 1:3], None))

    aim = np.full((1, 1), max(AIM_TIME * speed, LEAST_AIM))
    steering = [action[1]]
    for path in paths[1:]:
        target = along(path, aim)[0, 0, :2]
        steering.append(pursuit(player.dynamics, state, target, (float(low[1]), float(high[1]))))
    levels = np.linspace(low[0], high[0], LEVELS)
    # Cars that rest within the step need no stronger braking.
    braked = np.maximum(levels, -speed / dt)
    controls = [np.column_stack([braked, np.full(LEVELS, angle)]) for angle in steering]
    now = covered_distance(speed, levels, fastest, times)

    first = times <= dt
    begin = covered_distance(speed, action[:1], fastest, times[first])
    ends = np.append(levels, action[0])
    end = step + covered_distance(after, ends, fastest, times[~first] - dt)
    later = np.concatenate([np.broadcast_to(begin, (len(ends), begin.shape[1])), end], axis=1)
    margins = np.array([0.0] + [SWERVE_MARGIN] * (len(paths) - 1))
    return Manoeuvres(
        np.concatenate(controls),
        *(
            Motions(
                np.concatenate([along(path, covered) for path in paths]),
                np.repeat(margins, len(covered)),
                tuple(path for path in paths for _ in covered),
            )
            for covered in (now, later)
        ),
    )
