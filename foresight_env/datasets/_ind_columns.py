"""The columns of the three inD files, filled from tracks."""

from collections.abc import Sequence

import numpy as np

from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track

_VULNERABLE_KINDS = ("pedestrian", "bicycle")


def track_rows(tracks: Sequence[Track], number: int, rate: float) -> dict[str, np.ndarray]:
    """Return the columns of ``NN_tracks.csv``: a row per agent and frame, in published order."""
    heading = np.concatenate([_stated_heading(track) for track in tracks])
    position = np.concatenate([track.position for track in tracks])
    velocity = np.concatenate([track.velocity for track in tracks])
    acceleration = np.concatenate([_acceleration(track, rate) for track in tracks])
    counts = [track.frames.size for track in tracks]

    def per_row(values: Sequence[int] | Sequence[float]) -> np.ndarray:
        return np.repeat(np.array(values), counts)

    cosine, sine = np.cos(heading), np.sin(heading)
    return {
        "recordingId": np.full(heading.size, number),
        "trackId": per_row([int(track.agent_id) for track in tracks]),
        "frame": np.concatenate([track.frames for track in tracks]),
        "trackLifetime": np.concatenate([track.frames - track.frames[0] for track in tracks]),
        "xCenter": position[:, 0],
        "yCenter": position[:, 1],
        "heading": np.rad2deg(heading),
        "width": per_row([_extent(track.width) for track in tracks]),
        "length": per_row([_extent(track.length) for track in tracks]),
        "xVelocity": velocity[:, 0],
        "yVelocity": velocity[:, 1],
        "xAcceleration": acceleration[:, 0],
        "yAcceleration": acceleration[:, 1],
        "lonVelocity": cosine * velocity[:, 0] + sine * velocity[:, 1],
        "latVelocity": cosine * velocity[:, 1] - sine * velocity[:, 0],
        "lonAcceleration": cosine * acceleration[:, 0] + sine * acceleration[:, 1],
        "latAcceleration": cosine * acceleration[:, 1] - sine * acceleration[:, 0],
    }


def track_meta(tracks: Sequence[Track], number: int) -> dict[str, np.ndarray]:
    """Return the columns of ``NN_tracksMeta.csv``: a row per agent."""
    return {
        "recordingId": np.full(len(tracks), number),
        "trackId": np.array([int(track.agent_id) for track in tracks]),
        "initialFrame": np.array([track.frames[0] for track in tracks]),
        "finalFrame": np.array([track.frames[-1] for track in tracks]),
        "numFrames": np.array([track.frames.size for track in tracks]),
        "width": np.array([_extent(track.width) for track in tracks]),
        "length": np.array([_extent(track.length) for track in tracks]),
        "class": np.array([track.kind for track in tracks]),
    }


def recording_row(recording: Recording, number: int, location: int) -> dict[str, np.ndarray]:
    """Return the columns of ``NN_recordingMeta.csv``: one row; the site's facts are 0."""
    first, last = recording.frame_range
    vehicles = sum(track.kind not in _VULNERABLE_KINDS for track in recording.tracks)
    values: dict[str, object] = {
        "recordingId": number,
        "locationId": location,
        "frameRate": recording.rate,
        "speedLimit": 0.0,
        "weekday": "unknown",
        "startTime": 0,
        "duration": (last - first + 1) / recording.rate,
        "numTracks": len(recording.tracks),
        "numVehicles": vehicles,
        "numVRUs": len(recording.tracks) - vehicles,
        "latLocation": 0.0,
        "lonLocation": 0.0,
        "xUtmOrigin": 0.0,
        "yUtmOrigin": 0.0,
        "orthoPxToMeter": 0.0,
    }
    return {name: np.array([value]) for name, value in values.items()}


def _extent(value: float) -> float:
    return value if np.isfinite(value) else 0.0


def _stated_heading(track: Track) -> np.ndarray:
    moving = np.arctan2(track.velocity[:, 1], track.velocity[:, 0])
    return np.where(np.isfinite(track.heading), track.heading, moving)


def _acceleration(track: Track, rate: float) -> np.ndarray:
    if track.frames.size < 2:
        return np.zeros_like(track.velocity)
    return np.asarray(np.gradient(track.velocity, track.frames / rate, axis=0))
