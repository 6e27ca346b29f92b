"""Small scenes of ETH/UCY as files: people who walk evenly in straight lines."""

from dataclasses import replace

import numpy as np

from foresight_env.datasets import Recording, Track, write_ucy

RATES = {"eth": 15.0, "hotel": 25.0, "students03": 25.0, "zara01": 25.0, "zara02": 25.0}
"""Frame numbers per second by recording."""
STEP_SECONDS = 0.4


def straight(name, start, velocity, rate, first=0, rows=22):
    """A person at `start` in row 0 who is there from row `first` on, for `rows` rows."""
    number = np.arange(first, first + rows)
    position = np.array(start) + STEP_SECONDS * number[:, None] * np.array(velocity)
    return Track(
        str(name),
        "pedestrian",
        np.round(number * STEP_SECONDS * rate).astype(int),
        position,
        np.full((rows, 2), 99.0),  # recorded velocities are not to be used
        np.full(rows, np.nan),
    )


def crossing(name, rate=25.0, rows=22):
    """Two people whose paths cross, a third who is alone far away, one who leaves early."""
    return Recording(
        name,
        "ucy",
        rate,
        (
            straight(1, (-6.0, 0.0), (1.0, 0.0), rate, rows=rows),
            straight(2, (0.0, -6.0), (0.0, 1.2), rate, rows=rows),
            straight(3, (200.0, 0.0), (0.0, 1.0), rate, rows=rows),
            straight(4, (2.0, 2.0), (0.5, 0.0), rate, rows=12),
        ),
    )


def turning(recording, agent="1", step=10, angle=0.5 * np.pi):
    """The same with one person who turns at a row."""
    track = recording.track(agent)
    moves = np.diff(track.position, axis=0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moves[step:] = moves[step:] @ turn.T
    position = np.concatenate([track.position[:1], track.position[0] + np.cumsum(moves, axis=0)])
    tracks = tuple(
        replace(t, position=position) if t.agent_id == agent else t for t in recording.tracks
    )
    return replace(recording, tracks=tracks)


def write_scenes(folder, make=crossing):
    """Write all five scenes; the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rate in RATES.items():
        write_ucy(make(name, rate), folder / f"{name}_obsmat.txt")
    return folder
