"""A plain CSV file with one row per agent and instant."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path

from foresight_env.datasets._columns import ColumnError, chosen_columns, tracks_of
from foresight_env.datasets._table import check_text_file
from foresight_env.datasets.errors import RecordingError
from foresight_env.datasets.recording import Recording, check_rate

__all__ = ["read_csv_table"]

_DELIMITERS = (",", ";", "\t")


def read_csv_table(
    path: str | os.PathLike[str], *, rate: float, columns: Mapping[str, str] | None = None
) -> Recording:
    """Read a CSV file with a header and one row per agent and instant, in any order.

    Args:
        path: the file; fields are separated by commas, semicolons or tabs and may be quoted.
        rate: Hz, at which the rows were recorded.
        columns: as `Recording.from_dataframe`.

    Returns:
        A recording with source ``'table'``, named after the file; see `Recording.from_dataframe`.

    Raises:
        RecordingError: the file is missing or faulty, lacks a column, or holds a value that cannot
            be used; the message names the column and the line.
        ValueError: `rate` is not positive and finite.
    """
    check_rate(rate)
    path = Path(path)
    header, delimiter = table_header(path)
    try:
        chosen = chosen_columns(header, columns)
    except ColumnError as error:
        raise RecordingError(path, 1, error.problem) from None
    repeated = [name for name in chosen.values() if header.count(name) > 1]
    if repeated:
        raise RecordingError(path, 1, f"the header names {repeated[0]} more than once")
    table, lines = _cells(path, header, delimiter, tuple(chosen.values()))
    try:
        tracks = tracks_of(table, chosen, rate)
    except ColumnError as error:
        line = 1 if error.row is None else lines[error.row]
        raise RecordingError(path, line, error.problem) from None
    return Recording(path.stem, "table", rate, tracks)


def table_header(path: Path) -> tuple[list[str], str]:
    """Return the names in a CSV file's first line, and the character that separates them.

    Raises:
        RecordingError: the file is missing, empty or binary.
    """
    first = check_text_file(path, whole=False)
    delimiter = max(_DELIMITERS, key=first.count)
    return [name.strip() for name in next(csv.reader([first], delimiter=delimiter))], delimiter


def _cells(
    path: Path, header: list[str], delimiter: str, names: tuple[str, ...]
) -> tuple[dict[str, list[str]], list[int]]:
    """Return the named columns as texts, and the line number of each row."""
    places = [header.index(name) for name in names]
    cells: list[list[str]] = []
    lines: list[int] = []
    with path.open("r", encoding="utf-8-sig", newline="") as stream:
        reader = csv.reader(stream, delimiter=delimiter, strict=True)
        try:
            next(reader)
            for fields in reader:
                if not fields:
                    continue  # a blank line
                if len(fields) != len(header):
                    raise RecordingError(
                        path,
                        reader.line_num,
                        f"{len(fields)} columns; there must be {len(header)}: {', '.join(header)}",
                    )
                cells.append([fields[place] for place in places])
                lines.append(reader.line_num)
        except (csv.Error, UnicodeDecodeError) as error:
            raise RecordingError(path, reader.line_num, f"cannot be parsed: {error}") from error
    columns = zip(*cells, strict=True) if cells else [()] * len(names)
    return {n: list(column) for n, column in zip(names, columns, strict=True)}, lines
