"""Windows as an observer has them at their last frame: nothing depends on later positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track, Window, backward_differences

__all__ = ["observed_window", "past_velocities"]

CAUSAL_SOURCES = ("dut", "ind")
"""Formats whose velocities are kept: by `benchmarks.velocity_leak` they lag behind the positions.
Those of ``obsmat.txt`` are backward differences in UCY's zara01 and zara02, but central ones in
ETH's hotel, forward ones in UCY's students03, and derivatives of splines elsewhere."""


def observed_window(
    recording: Recording, agents: Sequence[str], first_frame: int, steps: int, every: int
) -> Window:
    """Return `Recording.window` with velocities that depend on no position after the last frame.

    Velocities of `CAUSAL_SOURCES` are the recorded ones, all others those of `past_velocities`.

    Args:
        recording: with the agents.
        agents: ids, at least one, in the order of the result.
        first_frame: frame number of the first row.
        steps: number K >= 1 of frames; the last of them is the observer's present.
        every: distance in frame numbers.

    Returns:
        The window.

    Raises:
        ValueError: as `Recording.window`.
    """
    window = recording.window(agents, first_frame, steps, every)
    if recording.source in CAUSAL_SOURCES:
        return window
    states = window.states.copy()
    for i, agent in enumerate(agents):
        states[:, i, 2:] = past_velocities(recording.track(agent), window.frames, recording.rate)
    return replace(window, states=states)


def past_velocities(
    track: Track, frames: Int[np.ndarray, "K"], rate: float
) -> Float[np.ndarray, "K 2"]:
    """Return an agent's velocities from its positions up to the last of the frames.

    Args:
        track: the agent's.
        frames: (K,) increasing frame numbers.
        rate: Hz, frame numbers per second.

    Returns:
        (K, 2) m/s: from the row before to the frame's own; of the track's first row that of its
        second, where that is no later than the last frame, else 0. NaN where the track has no row.
    """
    known = track.frames <= frames[-1]
    times, positions = track.frames[known] / rate, track.position[known]
    velocities = backward_differences(times, positions)
    found = np.full((len(frames), 2), np.nan)
    for k, frame in enumerate(frames):
        row = int(np.searchsorted(track.frames, frame))
        if row < len(velocities) and track.frames[row] == frame:
            found[k] = velocities[row]
    return found
