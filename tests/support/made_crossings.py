"""Small recordings with known interactions."""

import numpy as np

from foresight_env.datasets import Recording, Track

RATE = 25.0
"""Frame numbers per second; as in UCY there is a row at every tenth, a step of 0.4 s."""


def walk(name, start, velocity, frames, kind="pedestrian"):
    """Even motion that is at `start` in frame 0."""
    numbers = np.array(frames)
    position = np.array(start) + numbers[:, None] / RATE * np.array(velocity)
    heading = np.arctan2(velocity[1], velocity[0]) if kind != "pedestrian" else np.nan
    return Track(
        name,
        kind,
        numbers,
        position,
        np.tile(np.array(velocity, dtype=float), (len(numbers), 1)),
        np.full(len(numbers), heading % (2.0 * np.pi)),
    )


def recording(*tracks, name="crossing"):
    return Recording(name, "ucy", RATE, tracks)


FRAMES = range(0, 400, 10)


def two_people():
    """They cross at the origin, 10 m and 11 m from where they start, after 8 and 8.8 s."""
    return recording(
        walk("1", (-10.0, 0.0), (1.25, 0.0), FRAMES),
        walk("2", (0.0, -11.0), (0.0, 1.25), FRAMES),
    )
