"""A recording: tracks of agents over numbered frames, and what can be done with them.

A recording is a value: every method returns a new object. Positions
are in metres, velocities in metres per second, angles in radians, times in seconds. The time of a
frame is its number divided by the recording's rate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from foresight_env.datasets._columns import chosen_columns, tracks_of
from foresight_env.datasets._resampling import resample_rows
from foresight_env.datasets.track import Track, Window

__all__ = ["Recording"]


def check_rate(rate: float) -> None:
    """Raise ValueError unless the rate is positive and finite."""
    if not (math.isfinite(rate) and rate > 0):
        raise ValueError(f"rate must be positive and finite, not {rate}")


@dataclass(frozen=True)
class Recording:
    """Recorded trajectories of one scene.

    Attributes:
        name: name of the recording within its data set, e.g. ``'07'``, ``'intersection_15'``.
        source: ``'ind'``, ``'dut'``, ``'ucy'`` or ``'table'``: the format it was read from.
        rate: Hz, frame numbers per second. A recording may have rows for every n-th frame number
            only (UCY: 25 Hz, every tenth, thus a row per 0.4 s): see `frame_step`.
        tracks: the agents' tracks, with unique ids.

    Raises:
        ValueError: the rate is not positive and finite, or two tracks share an id.
    """

    name: str
    source: str
    rate: float
    tracks: tuple[Track, ...]
    _index: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the rate and index the tracks by id."""
        check_rate(self.rate)
        object.__setattr__(self, "tracks", tuple(self.tracks))
        index = {track.agent_id: number for number, track in enumerate(self.tracks)}
        if len(index) != len(self.tracks):
            raise ValueError(f"recording {self.name!r} has two tracks with the same agent id")
        object.__setattr__(self, "_index", index)

    @classmethod
    def from_dataframe(
        cls,
        df: Any,
        *,
        rate: float,
        columns: Mapping[str, Any] | None = None,
        name: str = "table",
    ) -> "Recording":
        """Return the recording in a table that has one row per agent and instant, in any order.

        Args:
            df: a pandas or polars `DataFrame`, or a mapping of names to columns (arrays, lists).
            rate: Hz, at which the rows were recorded: frames per second. Rows may be missing.
            columns: the library's name -> the table's, for columns that are named differently:

                - ``time`` (s) or ``frame`` (whole numbers): one of the two. A time belongs to the
                  frame nearest to it and may differ from it by a tenth of ``1 / rate``.
                - ``agent``: names or whole numbers.
                - ``x``, ``y``: m.
                - ``kind``, optional: ``'pedestrian'`` (default), ``'bicycle'``, ``'car'`` or
                  another kind of vehicle; one per agent.
                - ``heading``, optional: rad, anticlockwise from the x axis; may be missing.

                A column that is left out has the library's name.
            name: name of the recording.

        Returns:
            A recording with source ``'table'``, agents in the order in which they first appear.
            Velocities are those from the row before to each row.

        Raises:
            ValueError: a column is missing, or a value in it cannot be used; the message names
                the column and the row.

        Examples:
            >>> table = {"t": [0.0, 0.1], "id": [7, 7], "x": [0.0, 0.1], "y": [0.0, 0.0]}
            >>> columns = {"time": "t", "agent": "id"}
            >>> Recording.from_dataframe(table, columns=columns, rate=10).agents
            ('7',)
        """
        check_rate(rate)
        chosen = chosen_columns([*getattr(df, "columns", df)], columns)
        table = {user: df[user] for user in chosen.values()}
        return cls(name, "table", rate, tracks_of(table, chosen, rate))

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents' ids, in the order of the tracks."""
        return tuple(self._index)

    @cached_property
    def frame_step(self) -> int:
        """Spacing of the rows in frame numbers: 1 in inD and DUT, 10 in UCY.

        It is the greatest common divisor of the differences within tracks: those that do not
        overlap may count from different frames (ETH). 1 where no track has two rows.
        """
        steps = [np.diff(track.frames) for track in self.tracks]
        return int(np.gcd.reduce(np.concatenate(steps))) or 1 if steps else 1

    @cached_property
    def frame_range(self) -> tuple[int, int]:
        """First and last frame number of any agent; raises ValueError for an empty recording."""
        if not self.tracks:
            raise ValueError(f"recording {self.name!r} has no tracks, hence no frames")
        return (
            min(int(track.frames[0]) for track in self.tracks),
            max(int(track.frames[-1]) for track in self.tracks),
        )

    def track(self, agent: str) -> Track:
        """Return one agent's track.

        Args:
            agent: its id.

        Returns:
            The track.

        Raises:
            ValueError: the id is unknown.
        """
        if agent not in self._index:
            known = ", ".join(self.agents[:8]) + (", ..." if len(self.agents) > 8 else "")
            raise ValueError(f"recording {self.name!r} has no agent {agent!r}; it has {known}")
        return self.tracks[self._index[agent]]

    def select(
        self,
        *,
        agents: Sequence[str] | None = None,
        frames: tuple[int, int] | None = None,
        every: int = 1,
    ) -> "Recording":
        """Return a recording with fewer agents or frames; nothing is interpolated or renumbered.

        Args:
            agents: ids to keep, in this order; None keeps all.
            frames: first and last frame number, both kept; None keeps all.
            every: keep frame numbers at this distance, counted from the first frame number (of
                `frames`, else of the recording). It counts frame numbers, not rows.

        Returns:
            The recording; agents without any row left are dropped.

        Raises:
            ValueError: an unknown agent, ``every < 1``, or ``first > last``.
        """
        if every < 1:
            raise ValueError(f"every must be at least 1, not {every}")
        tracks = self.tracks if agents is None else tuple(self.track(agent) for agent in agents)
        if not tracks:
            return replace(self, tracks=())
        first, last = self.frame_range if frames is None else frames
        if first > last:
            raise ValueError(f"first frame {first} lies behind last frame {last}")
        kept = []
        for track in tracks:
            inside = (track.frames >= first) & (track.frames <= last)
            inside &= (track.frames - first) % every == 0
            if inside.any():
                kept.append(track if inside.all() else track.restricted(inside))
        return replace(self, tracks=tuple(kept))

    def rotate(self, angle: float) -> "Recording":
        """Return the recording turned anticlockwise about the origin.

        Args:
            angle: rad.

        Returns:
            The recording with positions and velocities turned, and the angle added to headings,
            which lie in [0, 2*pi) (see `Window.unwrapped_headings` for headings without jumps).

        Raises:
            ValueError: the angle is not finite.
        """
        if not math.isfinite(angle):
            raise ValueError(f"angle must be finite, not {angle}")
        cosine, sine = math.cos(angle), math.sin(angle)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        return replace(
            self,
            tracks=tuple(
                replace(
                    track,
                    position=track.position @ turn.T,
                    velocity=track.velocity @ turn.T,
                    heading=np.mod(track.heading + angle, 2 * math.pi),
                )
                for track in self.tracks
            ),
        )

    def window(
        self,
        agents: Sequence[str],
        first_frame: int,
        steps: int,
        every: int | None = None,
    ) -> Window:
        """Return `agents` at `steps` frames ``first_frame, first_frame + every, ...`` as arrays.

        An agent without a row in one of these frames (not yet there, gone, or lost in between) is
        not present there, with NaN states: nothing is interpolated.

        Args:
            agents: ids, at least one; the result has their order.
            first_frame: frame number of the first row of the window.
            steps: number K >= 1 of frames.
            every: distance in frame numbers; None means `frame_step`, i.e. every recorded row.

        Returns:
            A window of A agents and K frames.

        Raises:
            ValueError: unknown or repeated agents, ``steps < 1``, ``every < 1``.
        """
        every = self.frame_step if every is None else every
        if steps < 1 or every < 1:
            raise ValueError(f"steps and every must be at least 1, not {steps} and {every}")
        if not agents or len(set(agents)) != len(agents):
            raise ValueError(f"agents must be different ids, at least one, not {list(agents)}")
        tracks = [self.track(agent) for agent in agents]
        frames = first_frame + every * np.arange(steps, dtype=np.int64)
        states = np.full((steps, len(tracks), 4), np.nan)
        headings = np.full((steps, len(tracks)), np.nan)
        present = np.zeros((steps, len(tracks)), dtype=bool)
        for number, track in enumerate(tracks):
            rows = np.minimum(np.searchsorted(track.frames, frames), track.frames.size - 1)
            seen = track.frames[rows] == frames
            rows = rows[seen]
            states[seen, number, :2] = track.position[rows]
            states[seen, number, 2:] = track.velocity[rows]
            headings[seen, number] = track.heading[rows]
            present[:, number] = seen
        return Window(
            agents=tuple(agents),
            kinds=tuple(track.kind for track in tracks),
            frames=frames,
            times=(frames - first_frame) / self.rate,
            states=states,
            headings=headings,
            present=present,
            extents=np.array([[track.length, track.width] for track in tracks], dtype=np.float64),
        )

    def resample(self, dt: float, *, maximal_gap: float | None = None) -> "Recording":
        """Return the recording at the times ``k * dt`` (k integer), by linear interpolation.

        Each track is interpolated only between its own first and last row, and only between two
        successive rows that are at most `maximal_gap` apart; inside a wider gap the result has no
        rows. Headings take the shorter way round. Times keep their origin: the new frame number
        k lies at ``k * dt`` in the time of this recording, and the new rate is ``1 / dt``. A track
        that covers none of these times is dropped.

        Args:
            dt: s, positive.
            maximal_gap: s; None means one row spacing (``frame_step / rate``), so that no missing
                row is bridged.

        Returns:
            The recording at the rate ``1 / dt``.

        Raises:
            ValueError: `dt` is not positive and finite, or `maximal_gap` is negative.
        """
        if not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"dt must be positive and finite, not {dt}")
        gap = self.frame_step / self.rate if maximal_gap is None else maximal_gap
        if not gap >= 0:
            raise ValueError(f"maximal_gap must not be negative, not {maximal_gap}")
        tracks = []
        for track in self.tracks:
            frames, columns = resample_rows(
                track.frames / self.rate,
                np.column_stack([track.position, track.velocity]),
                track.heading,
                dt,
                gap,
            )
            if frames.size:
                tracks.append(
                    replace(
                        track,
                        frames=frames,
                        position=columns[:, :2],
                        velocity=columns[:, 2:4],
                        heading=columns[:, 4],
                    )
                )
        return replace(self, rate=1.0 / dt, tracks=tuple(tracks))
