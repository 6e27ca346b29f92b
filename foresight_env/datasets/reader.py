"""Open a recording of any supported format."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from foresight_env.datasets._columns import INSTANTS, REQUIRED
from foresight_env.datasets._table import check_text_file
from foresight_env.datasets.csv_table import read_csv_table, table_header
from foresight_env.datasets.dut import dut_stem, read_dut
from foresight_env.datasets.errors import RecordingError
from foresight_env.datasets.ind import find_ind_recordings, read_ind
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.ucy import UCY_RATE, read_ucy

__all__ = ["Format", "open_recording", "recordings_below"]

Format = Literal["ind", "dut", "ucy", "table"]

_ACCEPTED = (
    "inD (a directory with NN_tracks.csv, NN_tracksMeta.csv, NN_recordingMeta.csv), "
    "DUT (*_ped_filtered.csv, *_veh_filtered.csv), UCY (eight numbers per line), or a CSV file "
    "with a header whose columns you name (columns, rate)"
)
_IND_SUFFIXES = ("_tracksMeta.csv", "_recordingMeta.csv", "_tracks.csv")


def open_recording(
    path: str | os.PathLike[str],
    *,
    format: Format | None = None,
    recording: int | str | None = None,
    columns: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read a recording, recognising its format by names and, failing that, by content.

    Args:
        path: a directory or any of the three files (inD); either file or the common stem (DUT);
            an ``obsmat.txt`` (UCY); a directory that holds exactly one clip of DUT or UCY; or a
            CSV file of your data.
        format: ``'ind'``, ``'dut'``, ``'ucy'`` or ``'table'`` (CSV); None recognises it.
        recording: number of the recording in a directory of inD, or name of the clip in a
            directory of DUT or UCY; may be left out where there is only one.
        columns: of a CSV file, as in `Recording.from_dataframe`; given, the file is one.
        rate: Hz. Of a CSV file that of its rows, and required; of UCY frame numbers per second,
            25 by default (ETH's first scene has 15). inD and DUT state theirs.

    Returns:
        The recording: see `read_ind`, `read_dut`, `read_ucy` and `read_csv_table`.

    Raises:
        RecordingError: nothing readable is there, the format is not recognised, the choice among
            several recordings is open, or the file is faulty.
        MissingExtraError: the format is inD or DUT and pyarrow is not installed.
        ValueError: `format` is none of the four, or it does not go with `columns` or `rate`.
    """
    if format not in (None, "ind", "dut", "ucy", "table"):
        raise ValueError(f"format must be 'ind', 'dut', 'ucy' or 'table', not {format!r}")
    if columns is not None and format not in (None, "table"):
        raise ValueError(f"columns: are those of a CSV file; leave them out with format {format!r}")
    path = Path(path)
    if path.is_dir():
        if columns is not None or format == "table":
            raise RecordingError(path, None, "is a directory; columns belong to a CSV file")
        return _open_in_directory(path, format, recording, rate)
    if format is None:
        format = "table" if columns is not None else _recognise(path)
    if format == "table":
        if rate is None:
            raise ValueError(f"rate: is missing; {path.name} does not state that of its rows (Hz)")
        return read_csv_table(path, rate=rate, columns=columns)
    if format == "ucy":
        return read_ucy(path, rate=UCY_RATE if rate is None else rate)
    _refuse_rate(path, format, rate)
    if format == "dut":
        return read_dut(path)
    for suffix in _IND_SUFFIXES:
        if path.name.endswith(suffix):
            number = path.name.removesuffix(suffix)
            if recording is not None and str(recording).lstrip("0") != number.lstrip("0"):
                raise RecordingError(path, None, f"is recording {number}, not {recording}")
            return read_ind(path.parent, number)
    raise RecordingError(
        path, None, "inD files are named NN_tracks.csv, NN_tracksMeta.csv, NN_recordingMeta.csv"
    )


def _refuse_rate(path: Path, format: Format, rate: float | None) -> None:
    if rate is not None:
        raise ValueError(f"rate: is {rate:g}; leave it out, {format} states that of {path.name}")


def _recognise(path: Path) -> Format:
    if path.name.endswith(_IND_SUFFIXES):
        return "ind"
    if dut_stem(path) is not None:
        return "dut"
    if not path.is_file():
        raise RecordingError(path, None, f"there is no such file; readable are {_ACCEPTED}")
    if path.suffix == ".csv" and _is_table(path):
        return "table"
    header = check_text_file(path)
    if "trackId" in header or "recordingId" in header:
        return "ind"
    if "x_est" in header:
        raise RecordingError(
            path, None, "holds DUT columns, but DUT files end in _ped_filtered.csv or _veh_..."
        )
    if path.name.endswith("obsmat.txt") or _are_numbers(header.split()):
        return "ucy"
    raise RecordingError(path, 1, f"the format is not recognised; readable are {_ACCEPTED}")


def _is_table(path: Path) -> bool:
    """Whether a CSV file has the library's names for columns."""
    names = set(table_header(path)[0])
    return names.issuperset(REQUIRED) and not names.isdisjoint(INSTANTS)


def _are_numbers(fields: list[str]) -> bool:
    try:
        return len([float(field) for field in fields]) == 8
    except ValueError:
        return False


def _open_in_directory(
    directory: Path,
    format: Format | None,
    recording: int | str | None,
    rate: float | None,
) -> Recording:
    choices = _choices(directory, format)
    if not choices:
        raise RecordingError(directory, None, f"holds no recording; readable are {_ACCEPTED}")
    if recording is None and len(choices) > 1:
        raise RecordingError(
            directory, None, f"holds {', '.join(choices)}; pass recording=... to choose one"
        )
    wanted = next(iter(choices)) if recording is None else str(recording)
    for name, (kind, path) in choices.items():
        same_number = name.isdecimal() and wanted.isdecimal() and int(name) == int(wanted)
        if name == wanted or same_number:
            if kind == "ucy":
                return read_ucy(path, rate=UCY_RATE if rate is None else rate)
            _refuse_rate(path, kind, rate)
            return read_ind(path, name) if kind == "ind" else read_dut(path)
    raise RecordingError(directory, None, f"has no recording {wanted}; it has {', '.join(choices)}")


def recordings_below(path: str | os.PathLike[str]) -> tuple[tuple[Path, str | None], ...]:
    """Return every recording in a directory and the directories below it, without reading them.

    Args:
        path: a directory, or a file.

    Returns:
        Pairs for ``open_recording(directory, recording=name)``, in the order of their paths; for
        a file, that file alone, with None as its name.

    Raises:
        RecordingError: there is none.
    """
    path = Path(path)
    if not path.is_dir():
        return ((path, None),)
    directories = [path, *sorted(p for p in path.rglob("*") if p.is_dir())]
    found = tuple((d, name) for d in directories for name in _choices(d, None))
    if not found:
        raise RecordingError(path, None, f"holds no recording; readable are {_ACCEPTED}")
    return found


def _choices(directory: Path, format: Format | None) -> dict[str, tuple[Format, Path]]:
    """The recordings of a directory by name: their format and what to read."""
    choices: dict[str, tuple[Format, Path]] = {}
    if format in (None, "ind"):
        choices |= {name: ("ind", directory) for name in find_ind_recordings(directory)}
    if format in (None, "dut"):
        for file in sorted(directory.glob("*_filtered.csv")):
            stem = dut_stem(file)
            if stem is not None:
                choices[stem.name.removesuffix("_traj")] = ("dut", stem)
    if format in (None, "ucy"):
        for file in sorted(directory.glob("*obsmat.txt")):
            choices[file.name.removesuffix("obsmat.txt").rstrip("_") or file.name] = ("ucy", file)
    return choices
