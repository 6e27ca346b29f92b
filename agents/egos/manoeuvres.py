"""Evasive manoeuvres of an ego: what it can do from now on, and after a given first action.

Walkers change their velocity and keep it. Cars choose an acceleration along their planned path, and
may swerve from it. Times are a grid from now on (s). A pose is `[px, py, heading]` (m, rad);
walkers' headings are 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.car_paths import beside, covered_distance, path_ahead, pursuit
from agents.interfaces.policy import Decision
from foresight_env.envs.core.scene import Scene
from foresight_env.games import Bounds, Vehicle
from foresight_env.games.kinds import PEDESTRIAN

DIRECTIONS = 16
"""Evenly spaced, in which a walker may evade."""
LEVELS = 5
"""Accelerations of a car, evenly spaced between its limits."""
SWERVES = (0.0, 1.5, -1.5)
"""Lateral offsets (m) by which a car may leave its planned path; the first is none."""
SWERVE_TIME, LEAST_SWERVE = 1.5, 8.0
"""Seconds, but at least m, that a swerve takes: at most 4 m/s^2 of lateral acceleration."""
AIM_TIME, LEAST_AIM = 0.6, 4.0
"""Seconds, but at least m, ahead of the place that a swerving car steers to."""


class Manoeuvres(NamedTuple):
    """Possible motions of the ego."""

    controls: Float[np.ndarray, "M m"]
    """First controls of the manoeuvres that begin now."""
    now: Float[np.ndarray, "M T 3"]
    """Poses of these."""
    later: Float[np.ndarray, "L T 3"]
    """Poses of manoeuvres that begin after a step with the decision's action; one continues it."""


def manoeuvres(
    scene: Scene,
    ego: int,
    state: Float[np.ndarray, "4"],
    decision: Decision,
    times: Float[np.ndarray, "T"],
) -> Manoeuvres:
    """Manoeuvres of the ego from its present state, by the kind of its motion."""
    drives = isinstance(scene.game.players[ego].dynamics, Vehicle)
    return (_driving if drives else _walking)(scene, ego, state, decision, times)


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
    return Manoeuvres(controls, now, np.concatenate([begin, end], axis=1))


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
) -> Manoeuvres:
    player, dt = scene.game.players[ego], scene.dt
    action = decision.action.astype(float)
    low, high = limits(player.control_bounds, 2)
    fastest = float(limits(player.state_bounds, 4)[1][2])
    route = scene.own(ego).theta.get("path")
    path = path_ahead(
        state[[0, 1, 3]],
        np.zeros((0, 2)) if decision.planned is None else decision.planned,
        None if route is None else route[:, :3],
    )
    speed = max(float(state[2]), 0.0)
    length = max(SWERVE_TIME * speed, LEAST_SWERVE)
    levels = np.linspace(low[0], high[0], LEVELS)

    aim = np.full((1, 1), max(AIM_TIME * speed, LEAST_AIM))
    steering = [action[1]]
    for offset in SWERVES[1:]:
        target = beside(path, aim, offset, 0.0, length)[0, 0, :2]
        steering.append(pursuit(player.dynamics, state, target, (float(low[1]), float(high[1]))))
    # A car that comes to rest within the step needs no stronger braking.
    braked = np.maximum(levels, -speed / dt)
    controls = np.concatenate(
        [np.column_stack([braked, np.full(LEVELS, angle)]) for angle in steering]
    )
    ways = covered_distance(speed, levels, fastest, times)
    now = np.concatenate([beside(path, ways, offset, 0.0, length) for offset in SWERVES])

    after = float(np.clip(speed + dt * action[0], 0.0, fastest))
    step = 0.5 * dt * (speed + after)
    first = times <= dt
    begin = covered_distance(speed, action[:1], fastest, times[first])
    ends = np.append(levels, action[0])
    end = step + covered_distance(after, ends, fastest, times[~first] - dt)
    ways = np.concatenate([np.broadcast_to(begin, (len(ends), begin.shape[1])), end], axis=1)
    later = [beside(path, ways, offset, step, length) for offset in SWERVES]
    return Manoeuvres(controls, now, np.concatenate(later))
