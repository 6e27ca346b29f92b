"""One agent's recorded trajectory, and a window of several as arrays.

Both are values: arrays are read-only or fresh, never shared with a caller who may change them.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

__all__ = ["Track", "Window"]


def _read_only(values: Any, dtype: type) -> np.ndarray:
    """Return `values` as a read-only array that no caller can change behind our back."""
    array: np.ndarray = np.asarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


def backward_differences(
    times: Float[np.ndarray, " F"], positions: Float[np.ndarray, "F 2"]
) -> Float[np.ndarray, "F 2"]:
    """Return velocities (m/s) from the row before to each row, which no later row enters.

    Args:
        times: (F,) s, strictly increasing.
        positions: (F, 2) m.

    Returns:
        (F, 2) m/s; of the first row that of the second, or 0 where there is no second.
    """
    if len(positions) < 2:
        return np.zeros_like(positions)
    steps = np.diff(positions, axis=0) / np.diff(times)[:, None]
    return np.concatenate([steps[:1], steps])


@dataclass(frozen=True, eq=False)
class Track:
    """One agent's recorded trajectory: one row per frame in which the agent was observed.

    Attributes:
        agent_id: unique within its recording, e.g. ``'201'`` (inD), ``'ped:6'`` (DUT).
        kind: ``'pedestrian'``, ``'car'``, ``'bicycle'``, ``'truck_bus'``, or another class name of
            the data set.
        frames: (F,) strictly increasing frame numbers, F >= 1; a number that is skipped is a frame
            in which the agent was not observed.
        position: (F, 2) m, finite.
        velocity: (F, 2) m/s, finite, in the same axes as the position.
        heading: (F,) rad, anticlockwise from the x axis; NaN where the data set states none.
        length, width: m; NaN where the data set states none.

    Raises:
        ValueError: a shape disagrees, frames do not increase, or a position or velocity is not
            finite.
    """

    agent_id: str
    kind: str
    frames: Int[np.ndarray, " F"]
    position: Float[np.ndarray, "F 2"]
    velocity: Float[np.ndarray, "F 2"]
    heading: Float[np.ndarray, " F"]
    length: float = math.nan
    width: float = math.nan

    def __post_init__(self) -> None:
        """Take read-only copies and check that they describe one trajectory."""
        frames = np.asarray(self.frames)
        if frames.dtype.kind not in "iu":
            raise ValueError(
                f"track {self.agent_id!r}: frames must be integers, not {frames.dtype}"
            )
        object.__setattr__(self, "frames", _read_only(frames, np.int64))
        for name in ("position", "velocity", "heading"):
            object.__setattr__(self, name, _read_only(getattr(self, name), np.float64))
        count = self.frames.size
        if count == 0 or self.frames.shape != (count,):
            raise ValueError(f"track {self.agent_id!r}: frames must have shape (F,) with F >= 1")
        for name, shape in (
            ("position", (count, 2)),
            ("velocity", (count, 2)),
            ("heading", (count,)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"track {self.agent_id!r}: {name} has shape {getattr(self, name).shape}; "
                    f"{count} frames need {shape}"
                )
        if np.any(np.diff(self.frames) <= 0):
            raise ValueError(f"track {self.agent_id!r}: frames must strictly increase")
        if not (np.isfinite(self.position).all() and np.isfinite(self.velocity).all()):
            raise ValueError(f"track {self.agent_id!r}: positions and velocities must be finite")

    def __eq__(self, other: object) -> bool:
        """Compare by value; NaN equals NaN, so that a track equals its own copy."""
        if not isinstance(other, Track):
            return NotImplemented
        names = ("frames", "position", "velocity", "heading", "length", "width")
        return (self.agent_id, self.kind) == (other.agent_id, other.kind) and all(
            np.array_equal(getattr(self, name), getattr(other, name), equal_nan=name != "frames")
            for name in names
        )

    __hash__ = None  # type: ignore[assignment]  # holds arrays, so equality cannot be hashed

    def restricted(self, rows: np.ndarray) -> "Track":
        """Return the track with fewer rows.

        Args:
            rows: a mask (F,) or an index array.

        Returns:
            The track of these rows.
        """
        return replace(
            self,
            frames=self.frames[rows],
            position=self.position[rows],
            velocity=self.velocity[rows],
            heading=self.heading[rows],
        )


@dataclass(frozen=True, eq=False)
class Window:
    """A fixed set of agents over a fixed grid of frames, as arrays.

    Attributes:
        agents, kinds: A names, in the order that was asked for.
        frames: (K,) frame numbers.
        times: (K,) s, starting at zero.
        states: (K, A, 4) ``[px, py, vx, vy]``, NaN where the agent was not observed.
        headings: (K, A) rad, NaN where not observed or not stated.
        present: (K, A) True where the recording has a row for this agent and frame.
        extents: (A, 2) ``[length, width]`` in m, NaN where not stated.
    """

    agents: tuple[str, ...]
    kinds: tuple[str, ...]
    frames: Int[np.ndarray, " K"]
    times: Float[np.ndarray, " K"]
    states: Float[np.ndarray, "K A 4"]
    headings: Float[np.ndarray, "K A"]
    present: Bool[np.ndarray, "K A"]
    extents: Float[np.ndarray, "A 2"]

    @property
    def complete(self) -> bool:
        """Whether every agent was observed in every frame."""
        return bool(self.present.all())

    def unwrapped_headings(self) -> Float[np.ndarray, "K A"]:
        """Return the headings without jumps of 2*pi between the frames of each agent.

        Files state headings in one turn, so a car that passes the branch jumps by 2*pi; a model
        that compares headings must not see that.

        Returns:
            (K, A) rad; NaN stays NaN.
        """
        result = self.headings.copy()
        for column in result.T:
            known = np.isfinite(column)
            column[known] = np.unwrap(column[known])
        return result
