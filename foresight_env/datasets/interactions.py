"""Find agents whose paths cross shortly after one another: the interactions worth replaying.

Definitions, for agents a and b of one recording:

- *Path*: the polyline through an agent's recorded positions in order of time. Rows that are
  further apart than the recording's `frame_step` (the agent was lost in between) are not joined.
- *Crossing point*: the one common point of a segment of a's path and a segment of b's. Stretches
  on one line do not cross. *Crossing time*: when the agent is there, by constant velocity along
  its segment.
- *Near crossing*: where the paths do not cross but come within `reach`: the middle of the closest
  points of two segments, with the times at those points. Recorded people begin and end at the edge
  of the picture, so a path often stops short of the other by less than a body's width.
- *Time difference*: ``|t_a - t_b|`` at the crossing point; among several of a pair the one with
  the least difference counts; near crossings count only for pairs without a crossing that
  qualifies. It is the post-encroachment time of the agents' reference points (Allen, Shin, Cooper,
  "Analysis of traffic conflicts and collisions", Transportation Research Record 667, 1978, define
  it for the bodies, which is shorter by the time that the bodies need to pass).
- *Crossing angle*: between the two displacements over one second around each crossing time, 0 to
  pi. People who walk side by side weave across each other's path at small angles, over and over.
- *Overlap*: the frames in which both have a row.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from foresight_env.datasets._crossings import Path, meetings, path_of
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track

__all__ = ["Interaction", "closest_crossings", "find_interaction"]

_MOTION_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class Interaction:
    """Two agents whose paths cross, and where to look.

    Attributes:
        agents: ids, the one that passes the crossing point first before the other.
        kinds: their kinds.
        point: (2,) m, the crossing point, or the middle of a near crossing.
        separation: m, distance of the two paths there: 0 where they cross.
        times: s, when the first and when the second agent pass it, as frame number over rate.
        angle: rad, crossing angle, 0 (same direction) to pi (opposite).
        minimum_distance: m, the least distance of the two reference points over the overlap.
        minimum_distance_frame: the frame of that.
        overlap_seconds: s, number of frames of the overlap times the spacing of the rows.
        first_frame, steps, every: a suggested window, ready for `Recording.window`: frames in
            which both are present, without a break, around the crossing.
    """

    agents: tuple[str, str]
    kinds: tuple[str, str]
    point: Float[np.ndarray, "2"]
    separation: float
    times: tuple[float, float]
    angle: float
    minimum_distance: float
    minimum_distance_frame: int
    overlap_seconds: float
    first_frame: int
    steps: int
    every: int

    @property
    def time_difference(self) -> float:
        """Seconds between the two agents' passing of the crossing point."""
        return self.times[1] - self.times[0]


def closest_crossings(
    recording: Recording,
    *,
    count: int | None = None,
    kinds: tuple[str, str] | None = None,
    max_time_difference: float = 5.0,
    max_distance: float = math.inf,
    reach: float = 0.5,
    min_overlap_seconds: float = 2.0,
    min_angle: float = math.radians(30.0),
    min_speed: float = 0.1,
    window_seconds: float = 10.0,
) -> tuple[Interaction, ...]:
    """Return the pairs of agents that pass their paths' crossing point closest in time.

    Every pair appears once, with its best crossing point, ranked by time difference, then by
    least distance, then by ids. See the module's docstring for the definitions.

    Args:
        recording: where to search; use `Recording.select` to search a part.
        count: how many to return at most; None returns all.
        kinds: keep pairs of these kinds only, in either order, e.g. ``('car', 'pedestrian')``.
        max_time_difference: s, at the crossing point.
        max_distance: m; keep pairs that come at least this close while both are present.
        reach: m; paths that come this close count as a near crossing, 0 for true crossings only.
            The default is about the width of a person.
        min_overlap_seconds: s, that both are present.
        min_angle: rad; a crossing counts if its angle is at least this and at most pi minus this.
        min_speed: m/s; a crossing counts if both agents' mean speed, over the second around
            their crossing times, is at least this: positions of standing agents tremble.
        window_seconds: s, greatest length of the suggested window (see `find_interaction`).

    Returns:
        The interactions; empty where nothing qualifies.

    Raises:
        ValueError: a limit is negative or NaN, ``count < 1``, or `min_angle` exceeds pi/2.
    """
    limits = (
        max_time_difference,
        max_distance,
        reach,
        min_overlap_seconds,
        min_speed,
        window_seconds,
    )
    if not all(limit >= 0 for limit in limits):
        raise ValueError("limits must not be negative")
    if not 0 <= min_angle <= math.pi / 2:
        raise ValueError(f"min_angle must be between 0 and pi/2, not {min_angle}")
    if count is not None and count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    found = []
    for first, second in _candidates(recording, kinds, min_overlap_seconds, reach):
        crossing = _best_crossing(first, second, max_time_difference, reach, min_angle, min_speed)
        if crossing is not None:
            interaction = _interaction(
                recording, first.track, second.track, crossing, window_seconds
            )
            if interaction is None:
                continue
            enough = interaction.overlap_seconds >= min_overlap_seconds * (1 - 1e-9)
            if enough and interaction.minimum_distance <= max_distance:
                found.append(interaction)
    found.sort(key=lambda item: (item.time_difference, item.minimum_distance, item.agents))
    return tuple(found[:count])


def find_interaction(
    recording: Recording, agents: Sequence[str], *, reach: float = 0.5, window_seconds: float = 10.0
) -> Interaction:
    """Return how two given agents cross, whatever the time, angle, speed and distance.

    The suggested window is the longest run of frames without a break in which both are present
    that contains the middle of the two crossing times (or, if none does, the run nearest to it),
    cut to `window_seconds` about that middle.

    Args:
        recording: holds both agents.
        agents: their two ids, in either order.
        reach: m; as in `closest_crossings`.
        window_seconds: s, greatest length of the suggested window.

    Returns:
        Their crossing.

    Raises:
        ValueError: the ids are not two known, different ones, the paths neither cross nor come
            within `reach`, a limit is negative, or the agents are never present in the same frame.
    """
    if len(agents) != 2 or agents[0] == agents[1]:
        raise ValueError(f"two different agents are needed, not {list(agents)}")
    if not (reach >= 0 and window_seconds >= 0):
        raise ValueError("limits must not be negative")
    first, second = (recording.track(agent) for agent in agents)
    path, other = (path_of(one, recording.rate, recording.frame_step) for one in (first, second))
    crossing = _best_crossing(path, other, math.inf, reach, 0.0, 0.0)
    if crossing is None:
        raise ValueError(
            f"the paths of agents {agents[0]!r} and {agents[1]!r} do not cross, nor come within "
            f"{reach} m of each other"
        )
    interaction = _interaction(recording, first, second, crossing, window_seconds)
    if interaction is None:
        raise ValueError(f"agents {agents[0]!r} and {agents[1]!r} are never present together")
    return interaction


def _candidates(
    recording: Recording,
    kinds: tuple[str, str] | None,
    min_overlap_seconds: float,
    reach: float,
) -> list[tuple[Path, Path]]:
    """Return the pairs that can qualify by their kinds, first and last frames, and boxes."""
    tracks = recording.tracks
    if len(tracks) < 2:
        return []
    paths = [path_of(track, recording.rate, recording.frame_step) for track in tracks]
    low = np.array([track.position.min(axis=0) for track in tracks])
    high = np.array([track.position.max(axis=0) for track in tracks])
    spans = np.array([track.frames[[0, -1]] for track in tracks])
    first, second = np.array(list(combinations(range(len(tracks)), 2))).T
    common = np.minimum(spans[first, 1], spans[second, 1]) - np.maximum(
        spans[first, 0], spans[second, 0]
    )
    # Both ends of the common span may be shared frames, hence one row spacing more.
    enough = common + recording.frame_step >= min_overlap_seconds * recording.rate * (1 - 1e-9)
    enough &= common >= 0
    meet = (low[first] <= high[second] + reach).all(axis=1)
    meet &= (low[second] <= high[first] + reach).all(axis=1)
    if kinds is not None:
        matches = [
            sorted(kinds) == sorted((tracks[a].kind, tracks[b].kind))
            for a, b in zip(first, second, strict=True)
        ]
        meet &= np.array(matches)
    chosen = np.flatnonzero(enough & meet)
    return [(paths[first[pair]], paths[second[pair]]) for pair in chosen]


@dataclass(frozen=True)
class _Crossing:
    """The crossing of a pair that counts; times and tracks in the order of the pair."""

    point: np.ndarray
    separation: float
    times: tuple[float, float]
    angle: float


def _best_crossing(
    first: Path,
    second: Path,
    max_time_difference: float,
    reach: float,
    min_angle: float,
    min_speed: float,
) -> _Crossing | None:
    """Return the qualifying crossing closest in time, else the near crossing, else None."""
    found = meetings(first, second, max_time_difference, reach)
    motion, seconds = first.motion(found.times[:, 0], _MOTION_SECONDS)
    other, other_seconds = second.motion(found.times[:, 1], _MOTION_SECONDS)
    turn = motion[:, 0] * other[:, 1] - motion[:, 1] * other[:, 0]
    angles = np.arctan2(np.abs(turn), (motion * other).sum(axis=1))
    slack = 1e-9
    valid = (angles >= min_angle - slack) & (angles <= math.pi - min_angle + slack)
    valid &= np.hypot(*motion.T) >= min_speed * seconds
    valid &= np.hypot(*other.T) >= min_speed * other_seconds
    if (valid & (found.separations == 0)).any():
        valid &= found.separations == 0
    if not valid.any():
        return None
    differences = np.where(valid, np.abs(found.times[:, 0] - found.times[:, 1]), math.inf)
    # Near crossings tie at time difference zero where two agents come within reach of each other
    # at once; there the closest place is meant.
    best = int(np.lexsort((found.separations, differences))[0])
    return _Crossing(
        point=found.points[best],
        separation=float(found.separations[best]),
        times=(float(found.times[best, 0]), float(found.times[best, 1])),
        angle=float(angles[best]),
    )


def _interaction(
    recording: Recording, first: Track, second: Track, crossing: _Crossing, window_seconds: float
) -> Interaction | None:
    """Return the interaction with its window, or None where the agents share no frame."""
    frames, rows, other_rows = np.intersect1d(
        first.frames, second.frames, assume_unique=True, return_indices=True
    )
    if frames.size == 0:
        return None
    distances = np.hypot(*(first.position[rows] - second.position[other_rows]).T)
    nearest = int(np.argmin(distances))
    step = recording.frame_step
    middle = (crossing.times[0] + crossing.times[1]) / 2 * recording.rate
    run = _run_around(frames, step, middle, window_seconds * recording.rate)
    times = crossing.times
    if times[1] < times[0]:
        first, second, times = second, first, times[::-1]
    return Interaction(
        agents=(first.agent_id, second.agent_id),
        kinds=(first.kind, second.kind),
        point=crossing.point,
        separation=crossing.separation,
        times=times,
        angle=crossing.angle,
        minimum_distance=float(distances[nearest]),
        minimum_distance_frame=int(frames[nearest]),
        overlap_seconds=frames.size * step / recording.rate,
        first_frame=int(run[0]),
        steps=int(run.size),
        every=step,
    )


def _run_around(frames: np.ndarray, step: int, middle: float, window_frames: float) -> np.ndarray:
    """Return the unbroken run of `frames` at or nearest to `middle`, cut to the window's length."""
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > step) + 1)
    run = min(runs, key=lambda part: max(part[0] - middle, middle - part[-1], 0.0))
    size = max(1, int(min(window_frames / step * (1 + 1e-9), run.size)) + 1)
    start = int(np.searchsorted(run, middle)) - size // 2
    start = max(0, min(start, run.size - size))
    return np.asarray(run[start : start + size])
