"""Features of a history for networks: each agent in its own frame, at fixed steps, padded.

The frame has its origin where the agent is now, and its first axis along the agent's velocity; so
forecasts do not depend on the origin or the direction of north. Steps are those that
networks are trained with, whatever the history's are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32

from agents.interfaces.predictor import History
from foresight_env.games.kinds import is_vehicle

STEP = 0.4
"""Seconds between the steps that networks see and predict."""
KNOWN = 8
"""Steps that they see, the last of them now: 2.8 s."""
AHEAD = 10
"""Steps that they predict: 4 s."""
AGENTS = 8
"""Places for agents; of more, the first."""
NEAR = 20.0
"""Distances are given in this unit where they are between agents, m."""


class Features(NamedTuple):
    """Inputs of a network, for A places of which some are empty."""

    past: Float32[np.ndarray, "A known 5"]
    """In each agent's frame: place (m), velocity (m/s), and 1 where it was observed."""
    kind: Float32[np.ndarray, "A 2"]
    """1 for vehicles; speed, m/s."""
    others: Float32[np.ndarray, "A A 6"]
    """Of agent j in i's frame: place over `NEAR`, velocity, direction's cosine and sine."""
    there: Bool[np.ndarray, "A"]
    """Which places hold an agent."""


class Frames(NamedTuple):
    """Present positions, and rotations from agents' own frames to the plane."""

    place: Float[np.ndarray, "A 2"]
    velocity: Float[np.ndarray, "A 2"]
    rotation: Float[np.ndarray, "A 2 2"]


def present_tracks(history: History) -> Float[np.ndarray, "known N 4"]:
    """Tracks at multiples of `STEP` before now, straight motion for agents out of sight now.

    Between observations by interpolation; NaN before the first.
    """
    steps, count = history.states.shape[:2]
    times = history.dt * (np.arange(steps) - (steps - 1))
    wanted = STEP * (np.arange(KNOWN) - (KNOWN - 1))
    found = np.full((KNOWN, count, 4), np.nan)
    for i in range(count):
        rows = history.seen(i)
        own, when = history.states[rows, i], times[rows]
        late = wanted > when[-1] + 1e-9
        for c in range(4):
            found[:, i, c] = np.interp(wanted, when, own[:, c])
        found[late, i, :2] += (wanted[late] - when[-1])[:, None] * own[-1, 2:]
        found[wanted < when[0] - 1e-9, i] = np.nan
    return found


def features_of(history: History) -> tuple[Features, Frames]:
    """Inputs for the first `AGENTS` agents of a history; the others are not observed."""
    tracks = present_tracks(history)
    count = min(len(history.kinds), AGENTS)
    tracks = tracks[:, :count]
    now = tracks[-1]
    speed = np.hypot(now[:, 2], now[:, 3])
    angle = np.where(speed > 1e-6, np.arctan2(now[:, 3], now[:, 2]), 0.0)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)

    def own_frame(vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., N, 2) of the plane, each in its agent's frame."""
        return np.einsum("...ni,nij->...nj", vectors, rotation)

    past = np.zeros((AGENTS, KNOWN, 5), np.float32)
    seen = ~np.isnan(tracks).any(axis=2)
    places = own_frame(tracks[..., :2] - now[:, :2])
    velocities = own_frame(tracks[..., 2:])
    whole = np.concatenate([places, velocities, np.ones((*places.shape[:2], 1))], axis=2)
    past[:count] = np.where(seen[..., None], whole, 0.0).swapaxes(0, 1)
    kind = np.zeros((AGENTS, 2), np.float32)
    kind[:count, 0] = [is_vehicle(k) for k in history.kinds[:count]]
    kind[:count, 1] = speed
    others = np.zeros((AGENTS, AGENTS, 6), np.float32)
    away = now[None, :, :2] - now[:, None, :2]
    turn = angle[None] - angle[:, None]
    seen_from = [
        np.einsum("ijk,ikl->ijl", v, rotation)
        for v in (away, np.broadcast_to(now[None, :, 2:], away.shape))
    ]
    others[:count, :count] = np.concatenate(
        [seen_from[0] / NEAR, seen_from[1], np.cos(turn)[..., None], np.sin(turn)[..., None]],
        axis=2,
    )
    there = np.arange(AGENTS) < count
    return Features(past, kind, others, there), Frames(now[:, :2], now[:, 2:], rotation)


def straight(frames: Frames, times: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P A 2"]:
    """Positions of agents at these times (s) in straight motion."""
    return np.asarray(frames.place + times[:, None, None] * frames.velocity)


def targets_of(
    frames: Frames, truth: Float[np.ndarray, "P N 2"], dt: float
) -> tuple[Float32[np.ndarray, "A ahead 2"], Bool[np.ndarray, "A ahead"]]:
    """Departures from straight motion at multiples of `STEP`, in own frames; and positions.

    `truth`: positions after 1..P steps of `dt`, NaN where an agent had left.
    """
    count = len(frames.place)
    wanted = STEP * np.arange(1, AHEAD + 1)
    times = dt * np.arange(len(truth) + 1)
    target = np.zeros((AGENTS, AHEAD, 2), np.float32)
    known = np.zeros((AGENTS, AHEAD), dtype=bool)
    line = straight(frames, wanted)
    for i in range(count):
        path = np.concatenate([frames.place[i][None], truth[:, i]])
        there = ~np.isnan(path[:, 0])
        inside = wanted <= times[there][-1] + 0.05
        at = np.stack([np.interp(wanted, times[there], path[there, c]) for c in (0, 1)], axis=1)
        target[i] = np.where(inside[:, None], (at - line[:, i]) @ frames.rotation[i], 0.0)
        known[i] = inside
    return target, known
