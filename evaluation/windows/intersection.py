"""A window of a recording at an intersection: who is chosen, and which game is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from evaluation.windows.junction import STANDING
from foresight_env.datasets import Recording, Window, open_recording
from foresight_env.games.game import Game
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.motion import driving_states
from foresight_env.games.roads import Lane
from foresight_env.scenarios.aachen import AACHEN_REGION, AACHEN_ROTATION
from foresight_env.scenarios.intersection import (
    Region,
    Violation,
    intersection_game,
    violations,
    without_violated,
)
from foresight_env.scenarios.junction import JUNCTION_REGION, LANES, PENALTY, WHEELBASE

Site = Literal["auto", "aachen", "open"]
LEAST_STEPS = 8
NEARBY = 20.0
"""How far outside the published region tracks at Aachen may lead, m."""
ON_LANE = 1.0
"""A published lane is a car's when the car is at most this far off it on average, m."""


@dataclass(frozen=True)
class Choice:
    """A user's choice of a window; hashable, so that processes can keep what they loaded."""

    data: str
    tracks: tuple[str, ...]
    frames: tuple[int, int] | None = None
    every: int = 6
    recording: str | None = None
    place: Site = "auto"
    """`"aachen"`: turned as published, with corners, road sides and lanes; `"open"`: as recorded,
    no region, lanes from the tracks; `"auto"`: the first for inD recordings that lie there."""
    wheelbase: float = WHEELBASE
    columns: tuple[tuple[str, str], ...] | None = None
    """Of a CSV file, as pairs of names: the library's and the file's."""
    rate: float | None = None
    """Hz, of a CSV file or of UCY (`open_recording`)."""


class Case(NamedTuple):
    """A loaded window of K steps and N agents."""

    name: str
    agents: tuple[str, ...]
    kinds: tuple[str, ...]
    dt: float
    states: Float[np.ndarray, "K N 4"]
    """`[px, py, vx, vy]` of people, `[px, py, v, psi]` of vehicles; NaN where missing."""
    present: Bool[np.ndarray, "K N"]
    at_aachen: bool
    wheelbase: float

    @property
    def walks(self) -> Bool[np.ndarray, "N"]:
        """Agents that move freely in the plane: pedestrians and bicycles."""
        return np.array([not is_vehicle(kind) for kind in self.kinds])


class WindowError(ValueError):
    """A window cannot be evaluated; the message says why."""


@lru_cache(maxsize=4)
def load(choice: Choice) -> Case:
    """The window, read once per process.

    Raises `RecordingError` for a bad file and `WindowError` for a choice that does not fit it.
    """
    recording = open_recording(
        Path(choice.data),
        recording=choice.recording,
        columns=None if choice.columns is None else dict(choice.columns),
        rate=choice.rate,
    )
    unknown = [agent for agent in choice.tracks if agent not in recording.agents]
    if unknown or not choice.tracks or len(set(choice.tracks)) < len(choice.tracks):
        shown = ", ".join(recording.agents[:12]) + (", ..." if len(recording.agents) > 12 else "")
        raise WindowError(
            f"--tracks: {','.join(choice.tracks)!r} are not different agents of {recording.name}, "
            f"which has {shown}"
        )
    if choice.every < 1 or choice.every % recording.frame_step:
        raise WindowError(
            f"--every: is {choice.every}; {recording.name} has rows at every "
            f"{recording.frame_step} frames, give a multiple of that"
        )
    first, last = choice.frames or _common_frames(recording, choice.tracks)
    steps = (last - first) // choice.every + 1
    if steps < LEAST_STEPS:
        raise WindowError(
            f"--frames: {first}:{last} at every {choice.every} are {max(steps, 0)} steps; a window "
            f"has at least {LEAST_STEPS}"
        )
    at_aachen = choice.place == "aachen" or (
        choice.place == "auto" and recording.source == "ind" and _lies_there(recording, choice)
    )
    turned = recording.rotate(AACHEN_ROTATION) if at_aachen else recording
    window = turned.window(choice.tracks, first, steps, choice.every)
    seldom = np.flatnonzero(window.present.sum(axis=0) < 2)
    if seldom.size:
        raise WindowError(
            f"--frames: {choice.tracks[seldom[0]]} is seen less than twice in {first}:{last}"
        )
    return Case(
        recording.name,
        window.agents,
        window.kinds,
        choice.every / recording.rate,
        _game_states(window),
        window.present,
        at_aachen,
        choice.wheelbase,
    )


def _common_frames(recording: Recording, tracks: Sequence[str]) -> tuple[int, int]:
    """From when the last of them appears until the first leaves."""
    frames = [recording.track(agent).frames for agent in tracks]
    return max(int(f[0]) for f in frames), min(int(f[-1]) for f in frames)


def _lies_there(recording: Recording, choice: Choice) -> bool:
    places = recording.select(agents=choice.tracks, frames=choice.frames).rotate(AACHEN_ROTATION)
    return bool(places.tracks) and all(
        (
            (t.position >= np.subtract(AACHEN_REGION.low, NEARBY))
            & (t.position <= np.add(AACHEN_REGION.high, NEARBY))
        ).all()
        for t in places.tracks
    )


def _game_states(window: Window) -> Float[np.ndarray, "K N 4"]:
    """Recorded states as the game has them, headings without jumps."""
    states = np.array(window.states)
    for i, kind in enumerate(window.kinds):
        if is_vehicle(kind):
            states[:, i] = driving_states(states[:, i], window.headings[:, i])
    return states


def fitted_game(case: Case, known: int, horizon: int) -> Game:
    """The game that is fitted when the first `known` steps are known.

    Cars follow the published lane they have kept to so far or, elsewhere, a line fitted to what
    has been seen of them, straight on beyond it. Corners and sides that an agent was seen in bind
    none of its class (`contradictions`): what one car drove over is no obstacle to cars. The others
    are elastic.
    """
    lanes = tuple(None if walks else _lane(case, i, known) for i, walks in enumerate(case.walks))
    found = contradictions(case, known)
    # Per class, not per agent: players of one class stay identical, one compiled cost for all.
    regions = tuple(
        without_violated(
            _region(case),
            [
                v
                for agent, w in zip(case.agents, case.walks, strict=True)
                if w == walks
                for v in found[agent]
            ],
        )
        for walks in case.walks
    )
    return intersection_game(case.kinds, lanes, regions, horizon, case.dt, case.wheelbase, PENALTY)


def contradictions(case: Case, known: int) -> dict[str, tuple[Violation, ...]]:
    """Return, per agent, the parts of the region that its first `known` steps contradict."""
    return {
        agent: violations(kind, _region(case), case.states[:known, i, :2])
        for i, (agent, kind) in enumerate(zip(case.agents, case.kinds, strict=True))
    }


def _region(case: Case) -> Region:
    return JUNCTION_REGION if case.at_aachen else Region()


def _lane(case: Case, agent: int, known: int) -> Lane | None:
    places = case.states[:known, agent, :2]
    places = places[~np.isnan(places[:, 0])]
    if case.at_aachen and len(places):
        off = [float(np.mean([abs(lane.offset(p)) for p in places])) for lane in LANES]
        if min(off) <= ON_LANE:
            return LANES[int(np.argmin(off))]
    if len(places) < 2 or np.hypot(*(places[-1] - places[0])) < STANDING:
        return None
    try:
        return Lane.fit(places, degree=2)
    except ValueError:
        return None  # it turns back on itself: no lane


def difference(
    case: Case, states: Float[np.ndarray, "K N 4"], start: int = 0
) -> Float[np.ndarray, "K N 4"]:
    """`states` minus the recorded ones from step `start` on, headings the short way round.

    0 where no agent was observed.
    """
    true = case.states[start : start + len(states)]
    gap: Any = states - true
    turning = ~case.walks
    gap[:, turning, 3] = np.mod(gap[:, turning, 3] + np.pi, 2.0 * np.pi) - np.pi
    seen = case.present[start : start + len(states)]
    return np.where(seen[..., None], gap, 0.0)
