"""The ``obsmat.txt`` format of the UCY and ETH pedestrian data sets.

Sources: Lerner, Chrysanthou, Lischinski, "Crowds by Example", Computer Graphics Forum 26(3), 2007
(UCY: zara01, zara02, ...); Pellegrini, Ess, Schindler, van Gool, "You'll Never Walk Alone", ICCV
2009 (ETH), whose table format this is. Eight numbers per line, separated by blanks, no header:
frame, id, x, z, y, vx, vz, vy in m and m/s; z is up. UCY has a row per 0.4 s: frame numbers step
by 10 at 25 frames per second.
"""

import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from foresight_env.datasets._table import read_numbers, require, sorted_groups
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.track import Track
from foresight_env.files import write_files

__all__ = ["UCY_RATE", "read_ucy", "write_ucy"]

UCY_RATE = 25.0
"""Hz, frame numbers per second of the UCY videos; rows come every tenth frame number."""

_COLUMNS = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")


def read_ucy(path: str | os.PathLike[str], *, rate: float = UCY_RATE) -> Recording:
    """Read one ``obsmat.txt``.

    Args:
        path: the file; there is no header, so its columns must be in the published order.
        rate: Hz, frame numbers per second: 25 for UCY (and ETH hotel), 15 for ETH's first scene.

    Returns:
        A recording of pedestrians with plain ids (``'16'``) and no headings, named after the file
        (``'zara01'`` for ``zara01_obsmat.txt``) or, for a bare ``obsmat.txt``, its directory.

    Raises:
        RecordingError: the file is missing, faulty or cut off inside a line, or has a row twice.
            A file that ends early at the end of a line cannot be distinguished from a whole one.
        ValueError: `rate` is not positive and finite.
    """
    path = Path(path)
    values = read_numbers(path, _COLUMNS)
    for column, name in enumerate(_COLUMNS[:2]):
        numbers = values[:, column]
        # Above 2**53 neighbouring whole numbers are one float, so ids or frames would merge.
        whole = (numbers == np.floor(numbers)) & (np.abs(numbers) < 2**53)
        require(path, whole, numbers, name, "a whole number", header=False)
    frames, agents = values[:, 0].astype(np.int64), values[:, 1].astype(np.int64)
    tracks = [
        Track(
            agent_id=str(agent),
            kind="pedestrian",
            frames=frames[own],
            position=values[own][:, [2, 4]],
            velocity=values[own][:, [5, 7]],
            heading=np.full(own.size, np.nan),
        )
        for agent, own in sorted_groups(path, agents, frames, header=False)
    ]
    name = path.stem.removesuffix("obsmat").rstrip("_") or path.absolute().parent.name
    return Recording(name=name, source="ucy", rate=rate, tracks=tuple(tracks))


def write_ucy(
    recording: Recording, path: str | os.PathLike[str], *, overwrite: bool = False
) -> Path:
    """Write a recording as ``obsmat.txt``, so that `read_ucy` returns the same tracks.

    Numbers are written with full precision. The format does not state the frame rate, so it has
    to be given again to `read_ucy` if it is not 25; lengths, widths and headings are lost.

    Args:
        recording: of pedestrians whose ids are whole numbers (``'16'``).
        path: the file to write.
        overwrite: whether an existing file may be replaced.

    Returns:
        The path.

    Raises:
        ValueError: there are no tracks, or an agent is no pedestrian or has another kind of id.
        FileExistsError: the file exists and `overwrite` is False.
    """
    if not recording.tracks:
        raise ValueError("a recording without tracks cannot be written")
    for track in recording.tracks:
        agent = track.agent_id
        fits = agent.isascii() and agent.isdecimal() and str(int(agent)) == agent
        if track.kind != "pedestrian" or not fits or int(agent) >= 2**53:
            raise ValueError(
                f"agent {agent!r} of kind {track.kind!r} does not fit obsmat.txt, which holds "
                "pedestrians with whole numbers as ids"
            )
        if np.abs(track.frames[[0, -1]]).max() >= 2**53:
            raise ValueError(f"agent {agent!r} has frame numbers that are too great for obsmat.txt")
    blocks = []
    for track in recording.tracks:
        block = np.zeros((track.frames.size, len(_COLUMNS)))
        block[:, 0] = track.frames
        block[:, 1] = int(track.agent_id)
        block[:, [2, 4]] = track.position
        block[:, [5, 7]] = track.velocity
        blocks.append(block)
    values = np.concatenate(blocks)

    def write(stream: BinaryIO) -> None:
        # 17 significant digits state every float64 exactly.
        np.savetxt(stream, values, fmt="%.16e", delimiter="   ")

    write_files({Path(path): write}, overwrite=overwrite)
    return Path(path)
