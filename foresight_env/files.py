"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO


def write_files(
    contents: Mapping[Path, Callable[[BinaryIO], object]], *, overwrite: bool = True
) -> None:
    """Write files so that each appears whole or not at all.

    All contents are written next to their targets first and moved into place when the last is on
    disk; each move is atomic.

    Args:
        contents: target -> function that writes the content to an open binary file.
        overwrite: whether existing targets may be replaced.

    Raises:
        FileExistsError: a target exists and `overwrite` is False, also where another process
            creates it meanwhile.
    """
    existing = [os.fspath(path) for path in contents if path.exists()]
    if existing and not overwrite:
        raise FileExistsError(f"{', '.join(existing)} exists; pass overwrite=True to replace it")
    prepared: dict[Path, Path] = {}
    try:
        for path, write in contents.items():
            # Not `tempfile`, whose files only their owner may read.
            part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
            with part.open("xb") as stream:
                prepared[part] = path
                write(stream)
                stream.flush()
                os.fsync(stream.fileno())
        for part, path in prepared.items():
            if overwrite:
                os.replace(part, path)
            else:
                _claim(part, path)
    finally:
        for part in prepared:
            part.unlink(missing_ok=True)


def write_atomically(path: Path, data: bytes, *, overwrite: bool = True) -> None:
    """Write one file: readers see the old file or the new one, never a part. See `write_files`."""
    write_files({path: lambda stream: stream.write(data)}, overwrite=overwrite)


def _claim(part: Path, path: Path) -> None:
    """Give a file a name that no other file has."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links, where another process cannot be kept out
        if path.exists():
            raise FileExistsError(path) from None
        os.replace(part, path)
