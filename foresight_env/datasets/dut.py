"""The DUT format: one comma-separated file of pedestrians and one of vehicles per clip.

Source: Yang, Li, Redmill, Ozguner, "Top-view Trajectories: A Pedestrian Dataset of Vehicle-Crowd
Interaction from Controlled Experiments and Crowded Campus", IEEE Intelligent Vehicles Symposium
2019, arXiv 1902.00487. The filtered trajectories are read: 23.98 Hz, metres, radians. Pedestrians
and vehicles are numbered separately, hence the agent ids ``'ped:6'`` and ``'veh:0'``.
"""

import os
from pathlib import Path

import numpy as np

from foresight_env.datasets._table import (
    ColumnType,
    csv_content,
    read_csv,
    require,
    sorted_groups,
)
from foresight_env.datasets.errors import RecordingError
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track
from foresight_env.files import write_files

__all__ = ["DUT_RATE", "dut_stem", "read_dut", "write_dut"]

DUT_RATE = 23.98
"""Hz, frame rate of the DUT videos."""

_SUFFIXES = {"ped": "_ped_filtered.csv", "veh": "_veh_filtered.csv"}
_KINDS = {"ped": "pedestrian", "veh": "car"}
_COLUMNS: dict[str, dict[str, ColumnType]] = {
    "ped": {
        "id": "whole",
        "frame": "whole",
        "label": "text",
        "x_est": "number",
        "y_est": "number",
        "vx_est": "number",
        "vy_est": "number",
    },
    "veh": {
        "id": "whole",
        "frame": "whole",
        "label": "text",
        "x_est": "number",
        "y_est": "number",
        "psi_est": "number",
        "vel_est": "number",
    },
}


def dut_stem(path: str | os.PathLike[str]) -> Path | None:
    """Return the path without ``_ped_filtered.csv`` or ``_veh_filtered.csv``, or None.

    Args:
        path: either file, or what is before that suffix, with or without ``_traj``. None means
            that no such file exists.
    """
    path = Path(path)
    for suffix in _SUFFIXES.values():
        if path.name.endswith(suffix):
            return path.with_name(path.name.removesuffix(suffix))
    for stem in (path, path.with_name(f"{path.name}_traj")):
        if any(stem.with_name(stem.name + suffix).is_file() for suffix in _SUFFIXES.values()):
            return stem
    return None


def read_dut(path: str | os.PathLike[str]) -> Recording:
    """Read one clip of DUT.

    Args:
        path: ``..._ped_filtered.csv``, ``..._veh_filtered.csv``, or what the two names have in
            common. If one of the two files does not exist, the clip has no such agents.

    Returns:
        A recording named after the clip (``'intersection_15'``). Vehicles have kind ``'car'``,
        their heading is psi_est and their velocity ``vel_est * [cos psi_est, sin psi_est]``;
        pedestrians have no heading. The data set states no lengths and widths.

    Raises:
        RecordingError: neither file exists, or one is faulty or cut off, or has a row twice.
    """
    stem = dut_stem(path)
    files = {} if stem is None else _existing_files(stem)
    if stem is None or not files:
        raise RecordingError(
            path, None, f"there is neither *{_SUFFIXES['ped']} nor *{_SUFFIXES['veh']} here"
        )
    tracks = [track for label, file in files.items() for track in _read_tracks(file, label)]
    name = stem.name.removesuffix("_traj")
    return Recording(name=name, source="dut", rate=DUT_RATE, tracks=tuple(tracks))


def write_dut(
    recording: Recording, stem: str | os.PathLike[str], *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write a recording in DUT format, so that `read_dut` returns the same tracks.

    Numbers are written with full precision. The format has one speed per vehicle, along its
    heading, so a sideways velocity is lost, as are lengths, widths and pedestrians' headings.

    Args:
        recording: at 23.98 Hz, of agents ``'ped:N'`` (pedestrians) and ``'veh:N'`` (cars, whose
            headings are known).
        stem: the files are named ``<stem>_traj_ped_filtered.csv`` and ``..._veh_...`` (``_traj``
            is not repeated). A kind without agents gets no file.
        overwrite: whether an existing pair may be replaced. A file of the pair that the new clip
            does not have is then removed, because it would be read as part of it.

    Returns:
        The paths written.

    Raises:
        ValueError: there are no tracks, the rate differs, or ids, kinds or headings do not fit.
        FileExistsError: a file of the pair exists and `overwrite` is False.
    """
    if abs(recording.rate - DUT_RATE) > 1e-9:
        raise ValueError(f"DUT has {DUT_RATE} Hz, the recording {recording.rate}: resample it")
    if not recording.tracks:
        raise ValueError("a recording without tracks cannot be written")
    groups: dict[str, list[Track]] = {}
    for track in recording.tracks:
        label, _, number = track.agent_id.partition(":")
        fits = number.isascii() and number.isdecimal() and str(int(number)) == number
        if not fits or _KINDS.get(label) != track.kind:
            raise ValueError(
                f"agent {track.agent_id!r} of kind {track.kind!r} does not fit DUT: pedestrians "
                "are 'ped:N' and cars 'veh:N'"
            )
        if label == "veh" and not np.isfinite(track.heading).all():
            raise ValueError(f"agent {track.agent_id!r} has no heading; DUT needs one for vehicles")
        groups.setdefault(label, []).append(track)
    stem = Path(stem)
    if not stem.name.endswith("_traj"):
        stem = stem.with_name(f"{stem.name}_traj")
    stale = [file for label, file in _existing_files(stem).items() if label not in groups]
    if stale and not overwrite:
        raise FileExistsError(f"{stale[0]} exists; pass overwrite=True to replace the pair")
    paths = {label: stem.with_name(stem.name + _SUFFIXES[label]) for label in groups}
    write_files(
        {paths[label]: csv_content(_columns(tracks, label)) for label, tracks in groups.items()},
        overwrite=overwrite,
    )
    for file in stale:
        file.unlink()
    return tuple(paths.values())


def _existing_files(stem: Path) -> dict[str, Path]:
    files = {label: stem.with_name(stem.name + suffix) for label, suffix in _SUFFIXES.items()}
    return {label: file for label, file in files.items() if file.is_file()}


def _read_tracks(file: Path, label: str) -> list[Track]:
    rows = read_csv(file, _COLUMNS[label])
    require(file, rows["label"] == label, rows["label"], "label", repr(label))
    require(file, rows["id"] >= 0, rows["id"], "id", "0 or greater")
    if label == "veh":
        speed, heading = rows["vel_est"], rows["psi_est"]
        velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    else:
        velocity = np.column_stack([rows["vx_est"], rows["vy_est"]])
        heading = np.full(velocity.shape[0], np.nan)
    position = np.column_stack([rows["x_est"], rows["y_est"]])
    return [
        Track(
            agent_id=f"{label}:{number}",
            kind=_KINDS[label],
            frames=rows["frame"][own],
            position=position[own],
            velocity=velocity[own],
            heading=heading[own],
        )
        for number, own in sorted_groups(file, rows["id"], rows["frame"])
    ]


def _columns(tracks: list[Track], label: str) -> dict[str, np.ndarray]:
    # Published files are ordered by frame for pedestrians and by agent for vehicles; one order
    # does for both, since rows may come in any order.
    numbers = [int(track.agent_id.partition(":")[2]) for track in tracks]
    position = np.concatenate([track.position for track in tracks])
    velocity = np.concatenate([track.velocity for track in tracks])
    frames = np.concatenate([track.frames for track in tracks])
    columns = {
        "id": np.repeat(numbers, [track.frames.size for track in tracks]),
        "frame": frames,
        "label": np.full(frames.size, label),
        "x_est": position[:, 0],
        "y_est": position[:, 1],
    }
    if label == "ped":
        return columns | {"vx_est": velocity[:, 0], "vy_est": velocity[:, 1]}
    heading = np.concatenate([track.heading for track in tracks])
    speed = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    return columns | {"psi_est": heading, "vel_est": speed}
