"""The published inD format: three comma-separated files per recording, reader and writer.

Source: Bock, Krajewski, Moers, Runde, Vater, Eckstein, "The inD Dataset: A Drone Dataset of
Naturalistic Road User Trajectories at German Intersections", IEEE Intelligent Vehicles Symposium
2020. rounD, uniD and their siblings use the same columns. The data may not be redistributed; this
module holds none of it.

``NN_tracks.csv`` has a row per agent and frame, ``NN_tracksMeta.csv`` a row per agent,
``NN_recordingMeta.csv`` one row. Frames count at ``frameRate`` (25 Hz in inD); headings are in
degrees; a width or length of 0 (pedestrians, bicycles) means that it was not measured.
"""

import math
import os
from pathlib import Path

import numpy as np

from foresight_env.datasets._ind_columns import recording_row, track_meta, track_rows
from foresight_env.datasets._table import (
    ColumnType,
    csv_content,
    line_of_row,
    read_csv,
    require,
    sorted_groups,
)
from foresight_env.datasets.errors import RecordingError
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track
from foresight_env.files import write_files

__all__ = ["find_ind_recordings", "read_ind", "write_ind"]

_TRACK_COLUMNS: dict[str, ColumnType] = {
    "recordingId": "whole",
    "trackId": "whole",
    "frame": "whole",
    "xCenter": "number",
    "yCenter": "number",
    "heading": "number",
    "xVelocity": "number",
    "yVelocity": "number",
}
_META_COLUMNS: dict[str, ColumnType] = {
    "recordingId": "whole",
    "trackId": "whole",
    "initialFrame": "whole",
    "finalFrame": "whole",
    "numFrames": "whole",
    "width": "number",
    "length": "number",
    "class": "text",
}
_RECORDING_COLUMNS: dict[str, ColumnType] = {"recordingId": "whole", "frameRate": "number"}
_PARTS = ("tracks", "tracksMeta", "recordingMeta")


def find_ind_recordings(directory: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the numbers of the recordings in a directory of inD.

    Args:
        directory: with files ``NN_tracks.csv``.

    Returns:
        The numbers as written, in their order: ``('00', '07', ...)``; empty where there is none.
    """
    names = (path.name.removesuffix("_tracks.csv") for path in Path(directory).glob("*_tracks.csv"))
    return tuple(sorted(name for name in names if name.isdecimal()))


def read_ind(directory: str | os.PathLike[str], recording: int | str) -> Recording:
    """Read one recording in inD format.

    Args:
        directory: holds ``NN_tracks.csv``, ``NN_tracksMeta.csv`` and ``NN_recordingMeta.csv``.
        recording: its number, 7, ``'7'`` or ``'07'``.

    Returns:
        A recording named ``'07'`` whose agents have plain ids (``'201'``) and the data set's
        classes as kinds; headings in rad, in [0, 2*pi) if the file's are in [0, 360).

    Raises:
        RecordingError: a file is missing, faulty or cut off, has a row twice, or the three files
            disagree (the meta file says how many frames each agent has, so that lost rows at the
            end are noticed too).
    """
    name = _recording_name(Path(directory), recording)
    tracks_file, meta_file, recording_file = (
        Path(directory) / f"{name}_{part}.csv" for part in _PARTS
    )
    facts = read_csv(recording_file, _RECORDING_COLUMNS)
    rates = facts["frameRate"]
    require(recording_file, rates > 0, rates, "frameRate", "positive")
    if rates.size != 1:
        raise RecordingError(recording_file, 3, f"{rates.size} rows; there must be one")
    meta = read_csv(meta_file, _META_COLUMNS)
    rows = read_csv(tracks_file, _TRACK_COLUMNS)
    for path, table in ((recording_file, facts), (meta_file, meta), (tracks_file, rows)):
        numbers = table["recordingId"]
        require(path, numbers == int(name), numbers, "recordingId", f"{int(name)}, as in its name")
    for column in ("width", "length"):
        require(meta_file, meta[column] >= 0, meta[column], column, "0 (unknown) or positive")
    kinds = meta["class"]
    named = np.array([bool(kind.strip()) for kind in kinds])
    require(meta_file, named, kinds, "class", "the name of a class")

    groups = dict(sorted_groups(tracks_file, rows["trackId"], rows["frame"]))
    # Every agent has one row in the meta file, which `sorted_groups` checks with a constant frame.
    agents = dict(sorted_groups(meta_file, meta["trackId"], np.zeros_like(meta["trackId"])))
    for agent, own in groups.items():
        if agent not in agents:
            raise RecordingError(
                tracks_file,
                line_of_row(tracks_file, int(own.min())),
                f"track {agent} is not in {meta_file.name}; every track needs a row there",
            )
    tracks = []
    for agent, (meta_row,) in agents.items():
        own = groups.get(agent, np.empty(0, dtype=np.int64))
        frames = rows["frame"][own]
        found = (int(frames[0]), int(frames[-1]), frames.size) if frames.size else (0, -1, 0)
        stated = tuple(
            int(meta[column][meta_row]) for column in ("initialFrame", "finalFrame", "numFrames")
        )
        if found != stated:
            raise RecordingError(
                meta_file,
                line_of_row(meta_file, int(meta_row)),
                f"track {agent} should have frames {stated[0]} to {stated[1]}, {stated[2]} rows; "
                f"{tracks_file.name} has frames {found[0]} to {found[1]}, {found[2]} rows "
                "(is it cut off?)",
            )
        tracks.append(
            Track(
                agent_id=str(agent),
                kind=str(kinds[meta_row]).strip(),
                frames=frames,
                position=np.column_stack([rows["xCenter"][own], rows["yCenter"][own]]),
                velocity=np.column_stack([rows["xVelocity"][own], rows["yVelocity"][own]]),
                heading=np.deg2rad(rows["heading"][own]),
                length=float(meta["length"][meta_row]) or math.nan,
                width=float(meta["width"][meta_row]) or math.nan,
            )
        )
    return Recording(name=name, source="ind", rate=float(rates[0]), tracks=tuple(tracks))


def write_ind(
    recording: Recording,
    directory: str | os.PathLike[str],
    number: int,
    *,
    location: int = 0,
    overwrite: bool = False,
) -> tuple[Path, Path, Path]:
    """Write a recording in inD format, so that `read_ind` returns the same tracks.

    Numbers are written with full precision. What the format has and a `Recording` has not is
    derived: accelerations are differences of the velocities; a heading that is not known is the
    direction of the velocity; an unknown length or width is 0; columns about the site are 0.

    Args:
        recording: its agents' ids must be whole numbers (``'201'``).
        directory: an existing directory.
        number: the recording's number, 0 to 99; file names start with it.
        location: number of the site, written as locationId.
        overwrite: whether existing files may be replaced.

    Returns:
        The paths of the tracks, the tracks' meta and the recording's meta file.

    Raises:
        ValueError: there are no tracks, an id is no whole number, or `number` is out of range.
        FileExistsError: a file exists and `overwrite` is False.
    """
    if not 0 <= number <= 99:
        raise ValueError(f"number must be 0 to 99, not {number}")
    if not recording.tracks:
        raise ValueError("a recording without tracks cannot be written")
    wrong = [agent for agent in recording.agents if not (agent.isascii() and agent.isdecimal())]
    if wrong or len({int(agent) for agent in recording.agents}) < len(recording.agents):
        raise ValueError(
            f"inD needs different whole numbers as agent ids, not {wrong or recording.agents}"
        )
    tracks = sorted(recording.tracks, key=lambda track: int(track.agent_id))
    paths = tuple(Path(directory) / f"{number:02d}_{part}.csv" for part in _PARTS)
    contents = (
        track_rows(tracks, number, recording.rate),
        track_meta(tracks, number),
        recording_row(recording, number, location),
    )
    write_files(
        {path: csv_content(content) for path, content in zip(paths, contents, strict=True)},
        overwrite=overwrite,
    )
    return paths[0], paths[1], paths[2]


def _recording_name(directory: Path, recording: int | str) -> str:
    """Return the recording's number as the file names write it."""
    text = str(recording)
    if not (text.isascii() and text.isdecimal()):
        raise RecordingError(directory, None, f"recording {text!r} must be a whole number")
    found = find_ind_recordings(directory)
    for name in found:
        if int(name) == int(text):
            return name
    raise RecordingError(
        directory,
        None,
        f"has no recording {text}; it has {', '.join(found) if found else 'no *_tracks.csv'}",
    )
