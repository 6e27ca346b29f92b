"""Properties of recorded windows, whatever the predictor: a table next to the results.

A failed trial has no columns, and a report is to be made without the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.execution.store import Row, StoreError
from foresight_env.files import write_atomically

WINDOW = ("recording", "content", "frame", "agents")
"""Columns that identify a window; `content` is the recording's digest."""
FILE = "windows.parquet"


def write_windows(folder: Path, windows: Sequence[Row]) -> None:
    """Add windows to the table in a results folder: source, split, classes, group of each."""
    known = _read(folder) | {_key(row): row for row in windows}
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(list(known.values())), sink)
    try:
        write_atomically(folder / FILE, sink.getvalue().to_pybytes())
    except OSError as error:
        raise StoreError(f"{folder / FILE}: cannot be written ({error.strerror})") from error


def with_windows(folder: Path, rows: Sequence[Row]) -> list[Row]:
    """Rows of results with what is known of their windows."""
    known = _read(folder)
    try:
        return [{**row, **known[_key(row)]} for row in rows]
    except KeyError as error:
        raise StoreError(
            f"{folder / FILE}: lacks a window of the results; run the study again"
        ) from error


def _key(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in WINDOW)


def _read(folder: Path) -> dict[tuple[Any, ...], Row]:
    path = folder / FILE
    if not path.exists():
        return {}
    try:
        rows = pq.read_table(path).to_pylist()
    except (pa.ArrowInvalid, OSError) as error:
        raise StoreError(f"{path}: is damaged ({error}); delete it, run the study again") from error
    return {_key(row): row for row in rows}
