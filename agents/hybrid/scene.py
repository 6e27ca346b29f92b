"""Scenes as arrays: what the network sees of a history, and frames and bodies for the game."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32

from agents.hybrid.smooth_game import Bodies, Frames
from agents.hybrid.strategies import GAME_BASIS
from agents.interfaces.predictor import History
from agents.learned.features import STEP, Features, features_of, present_tracks
from agents.learned.features import Frames as LearnedFrames
from agents.predictors.kinematic import ConstantTurnRateAccelerationPredictor
from foresight_env.datasets import Route, routes_at
from foresight_env.games.kinds import body_radius, is_vehicle, kind_of

RECENT = (0.5, 0.3, 0.2)
"""Weights of the last velocities, newest first, in the one that frames have: single differences of
annotated positions are too noisy to turn frames by (UCY's students03)."""
ROUTES = 3
"""Routes that are given per vehicle; of more, the most frequent."""
ROUTE_POINTS = (4.0, 8.0, 16.0, 24.0, 32.0)
"""Distances ahead at which they are given, m."""
ROUTE_UNIT = 10.0
"""Unit of their coordinates, m."""
LEAST_SPEED = 0.5
"""Slower vehicles have no direction to find a route by, unless their heading is observed, m/s."""


class Scene(NamedTuple):
    """A scene of A places for agents, some of them empty; places are relative to its middle."""

    seen: Features
    routes: Float32[np.ndarray, "*b A routes numbers"]
    """Routes ahead in the agent's frame, over `ROUTE_UNIT`; the last number is 1 where there is
    one."""
    kinematic: Float32[np.ndarray, "*b A B 2"]
    """Coefficients of motion with constant turn rate and acceleration; of people, velocity."""
    roughness: Float32[np.ndarray, "*b A 2"]
    """Median length of positions' second differences per `STEP`, m: the agent's, the scene's."""
    frames: Frames
    """Now."""
    bodies: Bodies
    start: Frames
    """At the window's first step, with the axes of now."""
    window: Float32[np.ndarray, "*b A known 2"]
    """Observed positions, m."""
    followed: Bool[np.ndarray, "*b A"]
    """Agents that were observed at all steps of the window."""


def scene_of(history: History, agents: int) -> tuple[Scene, Float32[np.ndarray, "2"]]:
    """Return the scene of a history's first `agents` agents, and its middle (m)."""
    plain = smoothed(history)
    features, now = features_of(plain)
    count = len(now.place)
    tracks = present_tracks(plain)[:, :count]
    middle = now.place.mean(axis=0)
    seen = Features(
        features.past[:agents],
        features.kind[:agents],
        features.others[:agents, :agents],
        features.there[:agents],
    )
    count = min(count, agents)

    def placed(values: np.ndarray, blank: float = 0.0) -> Float32[np.ndarray, "..."]:
        found = np.full((agents, *values.shape[1:]), blank, np.float32)
        found[:count] = values[:count]
        return found

    rotation = np.tile(np.eye(2, dtype=np.float32), (agents, 1, 1))
    rotation[:count] = now.rotation[:count]
    frames = Frames(placed(now.place - middle), placed(now.velocity), rotation)
    window = tracks[..., :2].swapaxes(0, 1) - middle
    followed = ~np.isnan(window).any(axis=(1, 2))
    window = np.where(followed[:, None, None], window, 0.0)
    start = Frames(placed(window[:, 0]), placed((window[:, 1] - window[:, 0]) / STEP), rotation)
    known = placed(followed.astype(np.float32)) > 0.5
    scene = Scene(
        seen,
        _routes(plain, now.velocity, agents),
        placed(_kinematic(history, now)),
        placed(_roughness(history)),
        frames,
        _bodies(history, agents),
        start,
        placed(window),
        known,
    )
    return scene, middle.astype(np.float32)


def smoothed(history: History) -> History:
    """Return the history with each agent's last velocity a mean of its last ones (`RECENT`)."""
    states = history.states.copy()
    for i in range(states.shape[1]):
        late = history.seen(i)[::-1][: len(RECENT)]
        weights = np.array(RECENT[: len(late)])
        states[late[0], i, 2:] = weights @ history.states[late, i, 2:] / weights.sum()
    return replace(history, states=states)


def _kinematic(history: History, now: LearnedFrames) -> Float[np.ndarray, "A B 2"]:
    """Coefficients, in agents' axes, of the forecast of `ConstantTurnRateAccelerationPredictor`."""
    times = np.asarray(GAME_BASIS.times, dtype=float)
    steps = math.ceil(times[-1] / history.dt - 1e-6)
    path = ConstantTurnRateAccelerationPredictor().predict(history, steps).most_likely
    count = len(now.place)
    whole = np.concatenate([now.place[None], path[:, :count]])
    moments = history.dt * np.arange(steps + 1)
    at = np.stack(
        [[np.interp(times, moments, whole[:, i, c]) for c in (0, 1)] for i in range(count)]
    )
    away = at.swapaxes(1, 2) - now.place[:, None] - times[:, None] * now.velocity[:, None]
    fitted = np.linalg.pinv(GAME_BASIS.value.astype(float))
    return np.einsum("bt,ati,aik->abk", fitted, away, now.rotation)


def _roughness(history: History) -> Float[np.ndarray, "N 2"]:
    """Median lengths of positions' second differences per `STEP`, m: the agent's, the scene's.

    Where annotated positions are noisy the last velocity needs smoothing; where they are
    interpolated it is exact. Of histories with shorter steps the rows nearest to `STEP` apart
    count: noise would weigh more the shorter the step.
    """
    every = max(1, round(STEP / history.dt))
    kept = history.states[(len(history.states) - 1) % every :: every, :, :2]
    part = (STEP / (every * history.dt)) ** 2
    turns = [part * np.hypot(*np.diff(kept[:, i], 2, axis=0).T) for i in range(len(history.kinds))]
    known = [found[~np.isnan(found)] for found in turns]
    whole = np.concatenate(known)
    scene = float(np.median(whole)) if whole.size else 0.0
    return np.array([[np.median(own) if own.size else scene, scene] for own in known])


def _bodies(history: History, agents: int) -> Bodies:
    length, width = np.zeros((2, agents), np.float32)
    vehicle, there = np.zeros((2, agents), dtype=bool)
    for i, kind in enumerate(history.kinds[:agents]):
        there[i] = True
        vehicle[i] = is_vehicle(kind)
        if vehicle[i]:
            usual, stated = kind_of(kind), history.extents[i]
            size = np.where(stated > 0.0, stated, (usual.length, usual.width))
            length[i], width[i] = 0.5 * size
        else:
            length[i] = width[i] = body_radius(kind)
    return Bodies(length, width, vehicle, there)


def _routes(
    history: History, velocity: np.ndarray, agents: int
) -> Float32[np.ndarray, "A routes numbers"]:
    """Points ahead on the routes that vehicles may be on."""
    found = np.zeros((agents, ROUTES, 2 * len(ROUTE_POINTS) + 1), np.float32)
    context = history.context
    known = [Route(p, float(n)) for p, n in zip(context.routes, context.frequencies, strict=True)]
    if not known:
        return found
    for i in range(min(agents, len(velocity))):
        row = history.seen(i)[-1]
        heading, speed = history.headings[row, i], float(np.hypot(*velocity[i]))
        if np.isnan(heading) and speed >= LEAST_SPEED:
            heading = np.arctan2(velocity[i, 1], velocity[i, 0])
        if not is_vehicle(history.kinds[i]) or np.isnan(heading):
            continue
        place = history.states[row, i, :2]
        possible = routes_at(known, place, float(heading))
        # In the same axes as features.
        angle = np.arctan2(velocity[i, 1], velocity[i, 0]) if speed > 1e-6 else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        for k, route in enumerate(sorted(possible, key=lambda r: -r.frequency)[:ROUTES]):
            found[i, k, :-1] = (_ahead(route, place) @ turn.T / ROUTE_UNIT).ravel()
            found[i, k, -1] = 1.0
    return found


def _ahead(route: Route, place: np.ndarray) -> np.ndarray:
    """Points of a route ahead of the nearest one, relative to a place, m; its last beyond it."""
    path = route.path[:, :2]
    nearest = int(np.argmin(np.hypot(*(path - place).T)))
    rest = path[nearest:]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rest, axis=0).T))])
    return np.stack([np.interp(ROUTE_POINTS, arc, rest[:, c]) for c in (0, 1)], axis=1) - place


def targets(
    scene: Scene, middle: np.ndarray, truth: np.ndarray, dt: float, steps: int
) -> tuple[Float32[np.ndarray, "A steps 2"], Bool[np.ndarray, "A steps"]]:
    """Return later positions at multiples of `STEP`, relative to the middle, and which are known.

    `truth`: (P, N, 2) m after 1..P steps of `dt`, NaN where an agent is absent; what follows a gap
    does not count.
    """
    agents = len(scene.frames.place)
    wanted, times = STEP * np.arange(1, steps + 1), dt * np.arange(len(truth) + 1)
    target = np.zeros((agents, steps, 2), np.float32)
    known = np.zeros((agents, steps), dtype=bool)
    for i in range(min(agents, truth.shape[1])):
        path = np.concatenate([scene.frames.place[i][None] + middle, truth[:, i]])
        absent = np.flatnonzero(np.isnan(path[:, 0]))
        last = int(absent[0]) if absent.size else len(path)
        known[i] = wanted <= times[last - 1] + 0.05
        at = [np.interp(wanted, times[:last], path[:last, c]) for c in (0, 1)]
        target[i] = np.stack(at, axis=1) - middle
    return target, known
