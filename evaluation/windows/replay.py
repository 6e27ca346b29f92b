"""Episodes among recorded agents: the ego takes one pedestrian's place, the others are replayed.

Agents of a replay ignore the ego: they walk and drive as they did around the person whose place it
takes, and make way for that person at most. A collision therefore says less than one among agents
that react.

An episode is a crossing of two agents' paths (`datasets.closest_crossings`), one of them of a
pedestrian, whom the ego replaces. It begins `BEFORE` s before the first of them passes the crossing
point, or when both are there, and lasts `LONGEST` s, or as long as both are there. Others that are
there all the time take part, the nearest `MOST_OTHERS` of them. The goal is the place that the
person had reached after `GOAL_PART` of that time: the rest is there to be later. The egos take all
others to play the encounter game (`scenarios.encounter`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from evaluation.samples.recording import made_recording
from evaluation.windows.interaction import split_of
from foresight_env.datasets import (
    Interaction,
    Recording,
    closest_crossings,
    open_recording,
    recordings_below,
)
from foresight_env.envs.core.behaviours import BehaviourSetting, SolverReport
from foresight_env.envs.core.motion import applicable
from foresight_env.envs.core.parallel import WorldParallelEnv
from foresight_env.envs.core.scene import OpponentPrior
from foresight_env.envs.core.world import World
from foresight_env.envs.rendering.scenery import Scenery
from foresight_env.games import Game
from foresight_env.games.footprints import Footprint, Motion, least_gaps
from foresight_env.games.kinds import body_radius, is_vehicle, kind_of
from foresight_env.games.motion import driving_states
from foresight_env.scenarios.encounter import encounter_game, player_theta
from foresight_env.scenarios.episode_parameters import EpisodeParameters

STEP = 0.2
"""Duration of a step, s; as near to it as the recording's rows allow."""
HORIZON = 15
"""Stages of the egos' games."""
BEFORE, LONGEST, SHORTEST = 3.0, 10.0, 4.0
"""s."""
GOAL_PART = 0.75
GOAL_RADIUS = 1.5
"""m: an ego that made way walks on parallel to its preferred path."""
MOST_OTHERS = 3
LEAST_GAP = 0.2
"""Between the ego and any other at the start, m."""
NOISE_STD = 0.05
"""Of what the ego observes, m, m/s and rad."""
VELOCITY_DEVIATION, SPEED_DEVIATION = 0.5, 2.0
"""Of the preferred motion of people and of vehicles from their present one, m/s."""
SHOWN = 60.0
"""Largest coordinate in observations and largest speed, heading (m, m/s, rad)."""
TRACKING = 0.5
"""Part of its distance from the track that a replayed agent makes up in a step."""
PREFERRED = ("velocity", "speed", "curvature", "turn_weight")
"""Entries of `theta` that people or vehicles alone have."""


class ReplayedEpisode(NamedTuple):
    """A crossing in a recording, as an episode; the ego's track comes first."""

    name: str
    kinds: tuple[str, ...]
    tracks: Float[np.ndarray, "K N 4"]
    """`[px, py, vx, vy]` of people, `[px, py, v, psi]` of vehicles, at every step (m, m/s, rad)."""
    sizes: Float[np.ndarray, "N 2"]
    """Length and width, m."""
    dt: float

    @property
    def steps(self) -> int:
        """Steps until the episode is truncated."""
        return len(self.tracks) - 1

    @property
    def goal(self) -> Float[np.ndarray, "2"]:
        """Place that the ego has to come to, m."""
        found: Float[np.ndarray, "2"] = self.tracks[round(GOAL_PART * self.steps), 0, :2]
        return found


def replayed_episodes(data: str | Path | None, split: str) -> tuple[ReplayedEpisode, ...]:
    """All episodes of recordings: the first of each, by name, then the second of each, and so on.

    Args:
        data: folder or file of recordings (inD, DUT, UCY); None: one that the project makes itself,
            for any split.
        split: `"development"` or `"test"` (`evaluation.windows.interaction.split_of`).

    Raises:
        ValueError: no recording of the split holds an episode.
    """
    found = _episodes(None if data is None else str(data), split)
    if not found:
        raise ValueError(
            f"--data: no recording of the {split} split in {data} holds a crossing of a pedestrian "
            f"with another agent for {SHORTEST:g} s"
        )
    return found


@lru_cache(maxsize=4)
def _episodes(data: str | None, split: str) -> tuple[ReplayedEpisode, ...]:
    if data is None:
        recordings = [made_recording()]
    else:
        recordings = [
            open_recording(path, recording=name) for path, name in recordings_below(Path(data))
        ]
        recordings = [r for r in recordings if split_of(r.name) == split]
    found: list[tuple[int, ReplayedEpisode]] = []
    for recording in recordings:
        taken: set[str] = set()
        for crossing in closest_crossings(recording):
            walking = [
                a for a, k in zip(crossing.agents, crossing.kinds, strict=True) if k == "pedestrian"
            ]
            ego = next((a for a in walking if a not in taken), None)
            episode = None if ego is None else _episode(recording, crossing, ego)
            if ego is not None and episode is not None:
                found.append((len(taken), episode))
                taken.add(ego)
    return tuple(episode for _, episode in sorted(found, key=lambda pair: pair[0]))


def _episode(recording: Recording, crossing: Interaction, ego: str) -> ReplayedEpisode | None:
    """The crossing as an episode; None where it is too short or begins in contact."""
    rows = max(1, round(STEP * recording.rate / recording.frame_step))
    every = rows * recording.frame_step
    dt = every / recording.rate
    partner = next(a for a in crossing.agents if a != ego)
    seen = [recording.track(agent).frames for agent in (ego, partner)]
    early = round((min(crossing.times) - BEFORE) * recording.rate)
    first = max(int(seen[0][0]), int(seen[1][0]), early)
    # The first row of both at or after that frame.
    common = np.intersect1d(seen[0], seen[1])
    common = common[common >= first]
    if not common.size:
        return None
    first = int(common[0])
    last = min(int(seen[0][-1]), int(seen[1][-1]), first + round(LONGEST * recording.rate))
    steps = (last - first) // every + 1
    if (steps - 1) * dt < SHORTEST or crossing.times[0] * recording.rate < first:
        return None
    window = recording.window(recording.agents, first, steps, every)
    there = np.asarray(window.present.all(axis=0))
    index = {agent: k for k, agent in enumerate(window.agents)}
    if not (there[index[ego]] and there[index[partner]]):
        return None
    places = window.states[:, :, :2]
    others = [k for k, a in enumerate(window.agents) if there[k] and a not in (ego, partner)]
    distance = {
        k: float(np.linalg.norm(places[:, k] - places[:, index[ego]], axis=1).min()) for k in others
    }
    nearest = sorted(others, key=distance.__getitem__)[: MOST_OTHERS - 1]
    # By kind, so that few games differ.
    rest = sorted([index[partner], *nearest], key=lambda k: is_vehicle(window.kinds[k]))
    chosen = [index[ego], *rest]
    tracks = np.array(window.states[:, chosen])
    for column, k in enumerate(chosen):
        if is_vehicle(window.kinds[k]):
            tracks[:, column] = driving_states(window.states[:, k], window.headings[:, k])
    kinds = tuple(window.kinds[k] for k in chosen)
    usual = np.array([[kind_of(kind).length, kind_of(kind).width] for kind in kinds])
    sizes = np.where(np.isnan(window.extents[chosen]), usual, window.extents[chosen])
    name = f"{recording.name}, {ego}, frame {first}"
    episode = ReplayedEpisode(name, kinds, tracks, sizes, dt)
    clear = _gaps(episode, tracks[0], tracks[0])[0].min() >= LEAST_GAP
    away = np.linalg.norm(episode.goal - tracks[0, 0, :2]) > 2.0 * GOAL_RADIUS
    return episode if clear and away else None


class ReplayEnv(WorldParallelEnv):
    """One `ReplayedEpisode`, the same for every seed but for the noise of observations."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": "replay",
        "render_modes": ["human", "rgb_array"],
        "render_fps": round(1.0 / STEP),
        "is_parallelizable": True,
    }

    def __init__(self, episode: ReplayedEpisode, render_mode: str | None = None) -> None:
        super().__init__(
            replayed_world(episode),
            controlled=(0,),
            behaviour=partial(Replay, episode),
            observation="full",
            noise_std=NOISE_STD,
            planning_horizon=HORIZON,
            max_steps=episode.steps,
            render_mode=render_mode,
        )


class Replay:
    """Follows the recorded tracks, whatever the ego does."""

    report = SolverReport()
    planned: tuple[Float[np.ndarray, "K 2"], ...] | None = None

    def __init__(self, episode: ReplayedEpisode, setting: BehaviourSetting) -> None:
        self._episode, self._game, self._step = episode, setting.game(1), 0

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin at the tracks' first places."""
        self._step = 0

    def plan(self, states: Float[np.ndarray, "N n"]) -> None:
        """Return None: there is no plan."""

    def act(self, states: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 2"]:
        """Controls towards the tracks' next places."""
        tracks, dt = self._episode.tracks, self._episode.dt
        now = tracks[self._step]
        ahead = tracks[min(self._step + 1, len(tracks) - 1)]
        self._step += 1
        controls = np.zeros((len(states), 2))
        for i, (kind, state) in enumerate(zip(self._episode.kinds, states, strict=True)):
            lag = TRACKING * (now[i, :2] - state[:2]) / dt
            if is_vehicle(kind):
                controls[i] = _steered(state, ahead[i], lag, dt)
            else:
                # Velocities of the positions, since recorded ones may be a filter's, too late.
                later = (ahead[i, :2] - now[i, :2]) / dt
                controls[i] = (later + lag - state[2:]) / dt
        return applicable(self._game, states, controls)


def _steered(
    state: Float[np.ndarray, "4"],
    ahead: Float[np.ndarray, "4"],
    lag: Float[np.ndarray, "2"],
    dt: float,
) -> Float[np.ndarray, "2"]:
    """Acceleration and curvature that bring a vehicle to a place after a step."""
    way = ahead[:2] - state[:2]
    direction = np.array([np.cos(state[3]), np.sin(state[3])])
    speed = max(float(way @ direction) / dt, 0.0)
    across = direction[0] * way[1] - direction[1] * way[0]
    squared = max(float(way @ way), 1e-2)
    # The arc from the pose through the place; a vehicle that stands does not turn.
    curvature = 2.0 * across / squared if speed > 0.1 else 0.0
    return np.array([(speed - state[2]) / dt, curvature])


def replayed_world(episode: ReplayedEpisode) -> World:
    """World of one episode; its draw is the episode itself, with discount factors of 1."""
    kinds, tracks = episode.kinds, episode.tracks
    velocity = (episode.goal - tracks[0, 0, :2]) / (GOAL_PART * episode.steps * episode.dt)
    own = {
        # Entries of vehicles as well: an ego keeps the same entries of all players.
        **player_theta("car", (float(np.hypot(*velocity)), 0.0)),
        **player_theta("pedestrian", velocity),
        "goal": episode.goal,
    }
    theta = tuple(
        own
        if k == 0
        else {
            **player_theta(kind, (first[2], 0.0) if is_vehicle(kind) else first[2:]),
            "goal": last[:2].copy(),
        }
        for k, (kind, first, last) in enumerate(zip(kinds, tracks[0], tracks[-1], strict=True))
    )
    shown = np.full((len(kinds), 4), SHOWN)
    centre = np.zeros((len(kinds), 4))
    centre[:, :2] = tracks[0, 0, :2]
    middle = tracks[:, 0, :2].mean(axis=0)
    return World(
        names=tuple(f"{kind}_{i}" for i, kind in enumerate(kinds)),
        game=partial(_game, kinds, episode.dt),
        draw=lambda random: EpisodeParameters(tracks[0].copy(), theta, np.ones(len(kinds))),
        gaps=lambda before, controls, after: _gaps(episode, before, after),
        shown_low=centre - shown,
        shown_high=centre + shown,
        goal_radius=np.full(len(kinds), GOAL_RADIUS),
        footprints=_footprints(episode),
        scenery=Scenery("replay", (float(middle[0]), float(middle[1])), 10.0, ()),
        opponent_prior=OpponentPrior(
            ("velocity", "speed"),
            (("velocity", VELOCITY_DEVIATION), ("speed", SPEED_DEVIATION)),
            _keeps_its_motion,
        ),
    )


@lru_cache(maxsize=16)
def _game(kinds: tuple[str, ...], dt: float, horizon: int) -> Game:
    """The encounter game, in which all entries of `theta` may be given for all."""
    game = encounter_game(tuple("car" if is_vehicle(k) else k for k in kinds), horizon, dt)
    players = tuple(
        replace(player, extra_theta=(*player.extra_theta, *PREFERRED, "goal"))
        for player in game.players
    )
    return replace(game, players=players)


def _keeps_its_motion(
    own: dict[str, Any], track: Float[np.ndarray, "K 2"], state: Float[np.ndarray, "4"]
) -> tuple[dict[str, Any]]:
    """The preferred motion is the present one, of a person or a vehicle, whichever it is."""
    driver = player_theta("car", (float(state[2]), 0.0))
    return ({**driver, **own, "velocity": np.array(state[2:]), "goal": np.array(track[-1])},)


def _footprints(episode: ReplayedEpisode) -> tuple[Footprint, ...]:
    return tuple(
        Footprint(float(size[0]), float(size[1]))
        if is_vehicle(kind)
        else Footprint(radius=body_radius(kind))
        for kind, size in zip(episode.kinds, episode.sizes, strict=True)
    )


def _gaps(
    episode: ReplayedEpisode, before: Float[np.ndarray, "N 4"], after: Float[np.ndarray, "N 4"]
) -> Float[np.ndarray, "N N"]:
    """Smallest gaps during a step between the ego and the others, m; infinite between others."""
    moves = [
        Motion(a[:2], b[:2], float(a[3]), float(b[3] - a[3]))
        if is_vehicle(kind)
        else Motion(a[:2], b[:2], 0.0, 0.0)
        for kind, a, b in zip(episode.kinds, before, after, strict=True)
    ]
    return least_gaps(_footprints(episode), moves, lambda i, j: 0 in (i, j))
