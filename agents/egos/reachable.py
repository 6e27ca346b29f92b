"""Reachable places of others within stated bounds, and clearances of an ego's motions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.car_paths import along, covered_distance, path_ahead
from agents.egos.manoeuvres import limits
from agents.egos.motion import player_positions
from agents.egos.perception import Perception
from foresight_env.games import Vehicle
from foresight_env.games.footprints import gap
from foresight_env.games.motion import planar_velocity

NEAR = 2.0
"""Clearance (m) beyond which its lower bound by circumscribed circles suffices."""
SAME_WAY = 0.5
"""Cosine of the largest angle between two cars that go the same way."""


class Clearances(NamedTuple):
    """Gaps (m) of M motions at T times to the nearest other agent."""

    expected: Float[np.ndarray, "M T"]
    """Others keep their course; cars behind a driving ego brake with the bound's acceleration."""
    worst: Float[np.ndarray, "M T"]
    """Others depart from it with the bound's acceleration, whichever way is worst."""


def clearances(
    perception: Perception,
    own: Float[np.ndarray, "M T 3"],
    times: Float[np.ndarray, "T"],
    acceleration: float,
) -> Clearances:
    """Least gap (m) to any other at each time.

    Args:
        perception: of the ego.
        own: poses of the ego's M motions.
        times: from now on, s.
        acceleration: with which others may depart from their course, m/s^2: walkers in any
            direction, cars along their path.
    """
    scene, ego = perception.scene, perception.ego
    expected = np.full(own.shape[:2], np.inf)
    worst = expected
    for other in range(scene.players):
        if other != ego:
            poses, reach = _reachable(perception, other, times, acceleration)
            gaps = _gaps(perception, other, own, poses)
            expected = np.minimum(expected, gaps[:, 0])
            worst = np.minimum(worst, gaps.min(axis=1) - reach)
    return Clearances(expected, worst)


def _gaps(
    perception: Perception,
    other: int,
    own: Float[np.ndarray, "M T 3"],
    poses: Float[np.ndarray, "S T 3"],
) -> Float[np.ndarray, "M S T"]:
    """Gaps in the S cases; lower bounds where they are large."""
    footprints = perception.scene.footprints
    first, second = footprints[perception.ego], footprints[other]
    relative = poses[None, :, :, :2] - own[:, None, :, :2]
    found = np.linalg.norm(relative, axis=3) - first.reach - second.reach
    near = found < NEAR
    headings = np.broadcast_to(own[:, None, :, 2], found.shape)
    theirs = np.broadcast_to(poses[None, :, :, 2], found.shape)
    found[near] = gap(first, second, relative[near], headings[near], theirs[near])
    return np.asarray(found)


def _reachable(
    perception: Perception, other: int, times: Float[np.ndarray, "T"], acceleration: float
) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "T"]]:
    """Poses of another agent in S cases, the expected first, and its distance from them, m."""
    states = perception.states()
    player, state = perception.scene.game.players[other], states[other]
    if not isinstance(player.dynamics, Vehicle):
        velocity = planar_velocity(player.dynamics, state)
        places = state[:2] + times[:, None] * velocity
        poses = np.concatenate([places, np.zeros((len(times), 1))], axis=1)[None]
        return poses, 0.5 * acceleration * times**2
    cases = np.array([0.0, -1.0, 1.0]) * acceleration
    drives = isinstance(perception.scene.game.players[perception.ego].dynamics, Vehicle)
    if drives and _behind(states[perception.ego], state):
        cases = np.array([-acceleration])
    fastest = float(limits(player.state_bounds, 4)[1][2])
    covered = covered_distance(max(float(state[2]), 0.0), cases, fastest, times)
    paths = [
        path_ahead(state[[0, 1, 3]], np.zeros((0, 2)), route)
        for route in _routes(perception, other)
    ]
    poses = np.concatenate([along(path, covered) for path in paths])
    return poses, np.zeros(len(times))


def _routes(perception: Perception, other: int) -> list[Float[np.ndarray, "P 3"] | None]:
    """Possible routes of another car by the scene's prior; None in scenes without routes."""
    scene, ego = perception.scene, perception.ego
    own, prior = scene.own(ego).theta, scene.opponent_prior
    if "path" not in own:
        return [None]
    model = scene.observation_model(ego)
    track = player_positions(model, np.stack(perception.observations), other)
    track = track[~np.isnan(track).any(axis=1)]
    state = perception.states()[other]
    track = track if len(track) else state[None, :2]
    guesses = prior.guesses(own, track, state)
    return [np.asarray(guess["path"])[:, :3] for guess in guesses]


def _behind(ego: Float[np.ndarray, "4"], other: Float[np.ndarray, "4"]) -> bool:
    """Whether another car is behind an ego that drives the same way; `[px, py, v, psi]`."""
    away, direction = other[:2] - ego[:2], np.array([np.cos(ego[3]), np.sin(ego[3])])
    return bool(away @ direction < 0.0 and np.cos(other[3] - ego[3]) > SAME_WAY)
