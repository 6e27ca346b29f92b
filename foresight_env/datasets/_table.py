"""Strict, fast reading of text tables, and writing them.

A table is read by a compiled reader that stops at anything unexpected. Only then is the file read
a second time, slowly, to say in which line the trouble is: so a correct file of 100 MB loads in
seconds and a faulty one is still reported by line.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Literal, NoReturn

import numpy as np

from foresight_env.datasets.errors import RecordingError
from foresight_env.extras import require as require_extra

ColumnType = Literal["whole", "number", "text"]

_ARROW_TYPES = {"whole": "int64", "number": "float64", "text": "string"}
_PATTERNS = {
    "whole": re.compile(r"-?\d{1,18}"),
    "number": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    "text": re.compile(r".*"),
}
_MEANINGS = {"whole": "a whole number", "number": "a finite number", "text": "text"}
_BLOCK_BYTES = 1 << 23


def check_text_file(path: Path, *, whole: bool = True) -> str:
    """Return the first line, after checking that the file is a non-empty text file.

    `whole`: the last line must end in a newline.

    Raises:
        RecordingError: missing, empty or binary, or the last line is cut off.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(1 << 16)
            stream.seek(0, os.SEEK_END)
            size = stream.tell()
            stream.seek(max(0, size - 1))
            tail = stream.read(1)
    except OSError as error:
        raise RecordingError(path, None, f"cannot be read ({error.strerror})") from error
    if not head.strip():
        raise RecordingError(path, 1, "the file is empty; it must hold recorded rows")
    if b"\0" in head or head.startswith((b"\x1f\x8b", b"PK\x03\x04", b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError(path, 1, "this is a binary file; it must be plain, uncompressed text")
    # A number cut in its middle is still a number: the newline at the end is the only sign that
    # the last value is whole.
    if whole and tail not in b"\r\n":
        raise RecordingError(
            path,
            _count_lines(path),
            "the last line does not end in a newline, so the file may be cut off; "
            "fetch it again, or end the line if it is whole",
        )
    return head.splitlines()[0].decode("utf-8-sig", errors="replace").strip()


def read_csv(path: Path, columns: Mapping[str, ColumnType]) -> dict[str, np.ndarray]:
    """Read the named columns of a comma-separated file with a header.

    Args:
        path: the file. Its columns may be in any order, and there may be others.
        columns: name -> type of each column to read.

    Returns:
        name -> array with a row per line; finite numbers, int64 or float64, or str objects.

    Raises:
        MissingExtraError: pyarrow is not installed.
        RecordingError: anything that is not such a table, with its line.
    """
    require_extra("evaluation", f"reading {path}", "pyarrow")
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    header = [name.strip() for name in check_text_file(path).split(",")]
    missing = [name for name in columns if name not in header]
    if missing:
        raise RecordingError(
            path,
            1,
            f"the header lacks {', '.join(missing)}; it must name {', '.join(columns)}",
        )
    repeated = sorted({name for name in columns if header.count(name) > 1})
    if repeated:
        raise RecordingError(path, 1, f"the header names {', '.join(repeated)} more than once")
    try:
        with pa_csv.open_csv(
            os.fspath(path),
            # Names come from us, so that a header with blanks or a byte order mark still matches.
            read_options=pa_csv.ReadOptions(
                block_size=_BLOCK_BYTES,
                skip_rows=1,
                column_names=[
                    name if name in columns else f"unused {n}" for n, name in enumerate(header)
                ],
            ),
            parse_options=pa_csv.ParseOptions(quote_char=False),
            convert_options=pa_csv.ConvertOptions(
                column_types={
                    name: pa.type_for_alias(_ARROW_TYPES[kind]) for name, kind in columns.items()
                },
                include_columns=list(columns),
                null_values=[],
            ),
        ) as reader:
            batches = list(reader)
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeDecodeError) as error:
        _report_bad_csv_line(path, header, columns, str(error))
    table = pa.Table.from_batches(batches)
    if table.num_rows == 0:
        raise RecordingError(path, 2, "there are no rows under the header; remove the file instead")
    result = {name: table[name].to_numpy() for name in columns}
    for name, kind in columns.items():
        if kind == "number":
            require(path, np.isfinite(result[name]), result[name], name, _MEANINGS[kind])
    return result


def read_numbers(path: Path, names: Sequence[str]) -> np.ndarray:
    """Read a table of numbers separated by blanks, without a header.

    Args:
        path: the file.
        names: the columns' names, for messages; every line must have that many numbers.

    Returns:
        (rows, len(names)) finite numbers.

    Raises:
        RecordingError: anything that is not such a table, with its line.
    """
    check_text_file(path)
    try:
        with path.open("r", encoding="ascii") as stream:
            values = np.loadtxt(stream, dtype=np.float64, comments=None, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        _report_bad_number_line(path, names, str(error))
    if values.shape[1] != len(names):
        _report_bad_number_line(path, names, f"{values.shape[1]} columns")
    for column, name in enumerate(names):
        numbers = values[:, column]
        require(path, np.isfinite(numbers), numbers, name, _MEANINGS["number"], header=False)
    return values


def require(
    path: Path,
    valid: np.ndarray,
    values: np.ndarray,
    name: str,
    wanted: str,
    *,
    header: bool = True,
) -> None:
    """Raise a RecordingError at the line of the first row whose `values` are not `valid`."""
    if not valid.all():
        row = int(np.argmin(valid))
        line = line_of_row(path, row, header=header)
        raise RecordingError(path, line, f"{name} is {values[row]}; it must be {wanted}")


def sorted_groups(
    path: Path, ids: np.ndarray, frames: np.ndarray, *, header: bool = True
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (id, rows in order of frame) for each id, ascending, after refusing duplicate rows.

    Raises:
        RecordingError: two rows have the same id and frame; the line is that of the later one.
    """
    order = np.lexsort((frames, ids))  # stable, so equal keys stay in the order of the file
    sorted_ids, sorted_frames = ids[order], frames[order]
    same_id = sorted_ids[1:] == sorted_ids[:-1]
    duplicate = same_id & (sorted_frames[1:] == sorted_frames[:-1])
    if duplicate.any():
        row = int(order[1:][duplicate].min())
        raise RecordingError(
            path,
            line_of_row(path, row, header=header),
            f"agent {ids[row]} has a second row for frame {frames[row]}; one row per agent and "
            "frame is right",
        )
    return _split(sorted_ids, order, same_id)


def _split(
    sorted_ids: np.ndarray, order: np.ndarray, same_id: np.ndarray
) -> Iterator[tuple[int, np.ndarray]]:
    # A separate generator, so that `sorted_groups` checks when called, not when first iterated.
    starts = np.concatenate([[0], np.flatnonzero(~same_id) + 1])
    for start, rows in zip(starts, np.split(order, starts[1:]), strict=True):
        yield int(sorted_ids[start]), rows


def line_of_row(path: Path, row: int, *, header: bool = True) -> int:
    """Return the line number of data row `row` (from 0); blank lines are no rows."""
    for number, (line, _) in enumerate(_lines(path, header=header)):
        if number == row:
            return line
    raise AssertionError(f"{path} has fewer than {row + 1} rows")


def _lines(path: Path, *, header: bool) -> Iterator[tuple[int, str]]:
    # Text mode ends a line at a lone carriage return too, as the compiled readers do.
    with path.open("r", encoding="utf-8", errors="replace") as stream:
        for number, raw in enumerate(stream, start=1):
            line = raw.rstrip("\n")
            blank = not line if header else not line.strip()
            if not (blank or (header and number == 1)):
                yield number, line


def _count_lines(path: Path) -> int:
    with path.open("r", encoding="utf-8", errors="replace") as stream:
        return sum(1 for _ in stream)


def _report_bad_csv_line(
    path: Path, header: Sequence[str], columns: Mapping[str, ColumnType], cause: str
) -> NoReturn:
    kinds = [columns.get(name, "text") for name in header]
    for number, line in _lines(path, header=True):
        _check_fields(path, number, line.split(","), header, kinds)
    raise RecordingError(path, None, f"cannot be parsed: {cause}")


def _report_bad_number_line(path: Path, names: Sequence[str], cause: str) -> NoReturn:
    for number, line in _lines(path, header=False):
        _check_fields(path, number, line.split(), names, ["number"] * len(names))
    raise RecordingError(path, None, f"cannot be parsed: {cause}")


def _check_fields(
    path: Path,
    number: int,
    fields: Sequence[str],
    names: Sequence[str],
    kinds: Sequence[ColumnType],
) -> None:
    if len(fields) != len(names):
        raise RecordingError(
            path,
            number,
            f"{len(fields)} columns; there must be {len(names)}: {', '.join(names)}",
        )
    for value, name, kind in zip(fields, names, kinds, strict=True):
        if not _PATTERNS[kind].fullmatch(value.strip()) or "\N{REPLACEMENT CHARACTER}" in value:
            shown = value if len(value) <= 40 else value[:40] + "..."
            raise RecordingError(path, number, f"{name} is {shown!r}; it must be {_MEANINGS[kind]}")


def csv_content(columns: Mapping[str, np.ndarray]) -> Callable[[BinaryIO], None]:
    """Return a writer of a comma-separated file with a header; numbers keep full precision.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    require_extra("evaluation", "writing a recording", "pyarrow")
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    def write(stream: BinaryIO) -> None:
        stream.write((",".join(columns) + "\n").encode("ascii"))
        table = pa.table({name: pa.array(values) for name, values in columns.items()})
        options = pa_csv.WriteOptions(include_header=False, quoting_style="none")
        pa_csv.write_csv(table, stream, options)

    return write
