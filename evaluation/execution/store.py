"""Results on disk: Parquet parts written atomically, and a manifest that says what they are of.

A folder belongs to one study, one configuration and one state of the code (`code_digest`). An
interrupted study is resumed: trials that have a row are not run again.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.execution.code import code_digest
from foresight_env import __version__
from foresight_env.files import write_atomically

Trial = dict[str, Any]
"""Arguments of one trial; holds at least the store's key columns."""
Row = dict[str, Any]
"""Result of one trial: the key columns, its values, and `error` where it failed."""


UNKNOWN = "unknown"


class StoreError(ValueError):
    """A results folder cannot be used; the message says why and what to do."""


class Store:
    """One study's folder. `key` names the columns that identify a trial."""

    def __init__(
        self,
        folder: str | Path,
        study: str,
        configuration: Mapping[str, Any],
        key: tuple[str, ...],
        *,
        fresh: bool = False,
    ) -> None:
        """`fresh`: earlier results in the folder are deleted (other files never are)."""
        self.folder = Path(folder)
        self.key = key
        if fresh and (self.folder / "manifest.json").exists():
            for part in self.folder.glob("part-*.parquet"):
                part.unlink()
            (self.folder / "manifest.json").unlink()
        wanted = {
            "study": study,
            "code": code_digest(),
            "configuration": json.loads(json.dumps(configuration)),
        }
        manifest = self.folder / "manifest.json"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if manifest.exists():
                found = json.loads(manifest.read_text())
                kept = {name: found.get(name) for name in wanted}
                if kept != wanted:
                    raise StoreError(
                        f"{self.folder}: holds results of {_difference(kept, wanted)}; "
                        "choose another folder, or delete this one to run all trials again"
                    )
            else:
                # A kill may have left a hidden file of `write_atomically`.
                if any(not path.name.startswith(".") for path in self.folder.iterdir()):
                    raise StoreError(
                        f"{self.folder}: is not empty and has no manifest.json; choose another "
                        "folder"
                    )
                made = {
                    "version": __version__,
                    "python": platform.python_version(),
                    "machine": platform.machine(),
                }
                text = json.dumps({**wanted, "key": key, **made}, indent=2)
                write_atomically(manifest, text.encode())
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written ({error.strerror})") from error
        except json.JSONDecodeError as error:
            raise StoreError(f"{manifest}: is not JSON ({error}); delete the folder") from error

    def append(self, rows: Iterable[Row]) -> None:
        """Add finished trials as one new part; all of them or none."""
        listed = list(rows)
        if not listed:
            return
        # Arrow takes the columns from the first row alone, and a failed trial has fewer of them.
        names = list(dict.fromkeys(name for row in listed for name in row))
        table = pa.Table.from_pylist([{n: row.get(n) for n in names} for row in listed])
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        number = len(list(self.folder.glob("part-*.parquet")))
        while True:
            path = self.folder / f"part-{number:06d}.parquet"
            try:
                write_atomically(path, sink.getvalue().to_pybytes(), overwrite=False)
            except FileExistsError:  # another process writes into this folder, too
                number += 1
            except OSError as error:
                raise StoreError(f"{path}: cannot be written ({error.strerror})") from error
            else:
                return

    def rows(self) -> list[Row]:
        """All finished trials, one row each, in the order of their keys."""
        found = _read_parts(self.folder, self.key)
        return sorted(found, key=lambda row: tuple(_order(row[k]) for k in self.key))

    def finished(self) -> set[tuple[Any, ...]]:
        """Keys of the trials that have a row."""
        return {tuple(row[k] for k in self.key) for row in self.rows()}


class Results(NamedTuple):
    """Contents of a results folder."""

    folder: Path
    study: str
    configuration: dict[str, Any]
    code: str
    """Digest of the code that made them, see `code_digest`."""
    version: str
    """Version of this library that made them."""
    machine: str
    rows: list[Row]


def read_results(folder: Path) -> Results:
    """A folder of results as it is; what a row lacks (where a trial failed) is None."""
    manifest = folder / "manifest.json"
    try:
        recorded = json.loads(manifest.read_text())
        study, code = str(recorded["study"]), str(recorded.get("code", UNKNOWN))
        version = str(recorded.get("version", UNKNOWN))
        configuration = dict(recorded["configuration"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{manifest}: is no manifest of results ({error})") from error
    machine = f"Python {recorded.get('python', '?')}, {recorded.get('machine', '?')}"
    rows = _read_parts(folder, tuple(recorded.get("key", ())))
    return Results(folder, study, configuration, code, version, machine, rows)


def _read_parts(folder: Path, key: tuple[str, ...]) -> list[Row]:
    """All rows, as they were written; of a trial that two runs did at once the last (no key: all).

    What a row lacks is None.
    """
    found: dict[tuple[Any, ...], Row] = {}
    for part in sorted(folder.glob("part-*.parquet")):
        for row in _read_part(part):
            found[tuple(row[k] for k in key) if key else (len(found),)] = row
    names = sorted({name for row in found.values() for name in row})
    return [{name: row.get(name) for name in names} for row in found.values()]


def _order(value: Any) -> tuple[bool, bool, Any]:
    """Sorts numbers by size, before texts, and nothing before all."""
    return value is not None, isinstance(value, str), 0 if value is None else value


def _read_part(part: Path) -> list[Row]:
    try:
        rows: list[Row] = pq.read_table(part).to_pylist()
    except (pa.ArrowInvalid, OSError) as error:
        raise StoreError(f"{part}: is damaged ({error}); delete this part") from error
    return rows


def _difference(kept: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In what two manifests differ."""
    parts = [f"another study ({kept['study']})"] if kept["study"] != wanted["study"] else []
    if kept["code"] != wanted["code"]:
        parts.append(f"other code ({kept['code'] or UNKNOWN}; this is {wanted['code']})")
    old, new = kept["configuration"] or {}, wanted["configuration"]
    if old != new:
        names = sorted(n for n in old.keys() | new.keys() if old.get(n) != new.get(n))
        parts.append(f"another configuration ({', '.join(names)})")
    return " and ".join(parts)
