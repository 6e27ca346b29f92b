"""Tracks from the columns of a table with one row per agent and instant.

Values may be numbers or texts that state numbers, as a CSV file has them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from foresight_env.datasets.track import Track, backward_differences
from foresight_env.games.kinds import meant_kind

REQUIRED = ("agent", "x", "y")
INSTANTS = ("time", "frame")
OPTIONAL = ("kind", "heading")
NAMES = (*INSTANTS, *REQUIRED, *OPTIONAL)
"""The library's names for columns."""
DEFAULT_KIND = "pedestrian"
JITTER = 0.1
"""Largest distance of a time from that of its frame, as a share of the frames' spacing."""
LARGEST = 2.0**53
"""Above this neighbouring whole numbers are one float, so ids or frames would merge."""


class ColumnError(ValueError):
    """A column is missing or a value in it cannot be used.

    Attributes:
        row: of the value, from 0; None where the column as a whole is at fault.
        problem: the message without the row.
    """

    def __init__(self, problem: str, row: int | None = None) -> None:
        """Build the message from the problem and its row."""
        self.row = row
        self.problem = problem
        super().__init__(problem if row is None else f"row {row} (from 0): {problem}")


def chosen_columns(available: Sequence[Any], columns: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the user's name of each column that is read, by the library's name.

    Args:
        available: names of the table's columns.
        columns: the library's name -> the user's. Names that are left out are the library's own,
            where the table has them.

    Raises:
        ColumnError: a name is unknown, the table lacks a column, or a required one is not named.
    """
    given = dict(columns or {})
    for name in given:
        if name not in NAMES:
            raise ColumnError(f"columns: {name!r} is unknown; choose from {', '.join(NAMES)}")
    shown = ", ".join(str(name) for name in available)
    for name, user in given.items():
        if user not in available:
            raise ColumnError(f"columns: {name} is {user!r}, which the table lacks; it has {shown}")
    chosen = given | {n: n for n in NAMES if n in available and n not in given}
    if any(name in given for name in INSTANTS):
        chosen = {n: user for n, user in chosen.items() if n in given or n not in INSTANTS}
    missing = [name for name in REQUIRED if name not in chosen]
    if not any(name in chosen for name in INSTANTS):
        missing.insert(0, "time")
    if missing:
        example = f"columns={{{missing[0]!r}: ...}}"
        raise ColumnError(
            f"columns: no column for {', '.join(missing)}; the table has {shown}; name them, as in "
            f"{example}"
        )
    if all(name in chosen for name in INSTANTS):
        raise ColumnError("columns: both time and frame are given; choose one of them")
    return chosen


def tracks_of(
    table: Mapping[str, Any], chosen: Mapping[str, str], rate: float
) -> tuple[Track, ...]:
    """Return the tracks of a table, in the order in which agents first appear.

    Args:
        table: columns by the user's names, all of one length.
        chosen: the user's name of each column, by the library's (`chosen_columns`).
        rate: Hz, frames per second; positive and finite.

    Raises:
        ColumnError: a value is missing or impossible, an agent has two rows for one frame or two
            kinds, a time lies between frames, or the columns differ in length.
    """
    lengths = {user: len(table[user]) for user in chosen.values()}
    if len(set(lengths.values())) > 1:
        raise ColumnError(
            "columns differ in length: " + ", ".join(f"{k} {n}" for k, n in lengths.items())
        )
    agents = _agents(table[chosen["agent"]], chosen["agent"])
    if not agents:
        raise ColumnError("the table has no rows; expected one per agent and instant")
    frames = _frames(table, chosen, rate)
    position = np.stack([_numbers(table[chosen[k]], chosen[k]) for k in ("x", "y")], axis=1)
    heading = np.full(len(agents), math.nan)
    if "heading" in chosen:
        heading = _numbers(table[chosen["heading"]], chosen["heading"], missing=True)
    kinds = [DEFAULT_KIND] * len(agents)
    if "kind" in chosen:
        kinds = _kinds(table[chosen["kind"]], chosen["kind"])
    rows: dict[str, list[int]] = {}
    for row, agent in enumerate(agents):
        rows.setdefault(agent, []).append(row)
    tracks = []
    for agent, own in rows.items():
        order = np.array(own)[np.argsort(frames[own], kind="stable")]
        repeated = np.flatnonzero(np.diff(frames[order]) == 0)
        if repeated.size:
            row = int(order[1:][repeated].min())
            raise ColumnError(
                f"agent {agent} has a second row for frame {frames[row]}; expected one row per "
                "agent and instant",
                row,
            )
        for row in own:
            if kinds[row] != kinds[own[0]]:
                raise ColumnError(
                    f"{chosen['kind']} is {kinds[row]!r}, and {kinds[own[0]]!r} in another row of "
                    f"agent {agent}; expected one kind per agent",
                    row,
                )
        places = position[order]
        velocity = backward_differences(frames[order] / rate, places)
        tracks.append(Track(agent, kinds[own[0]], frames[order], places, velocity, heading[order]))
    return tuple(tracks)


def _numbers(values: Any, name: str, *, missing: bool = False) -> Float[np.ndarray, " R"]:
    """Return a column as floats; `missing`: empty cells and NaN are NaN, not an error."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array([_number(value, name, row, missing) for row, value in enumerate(values)])
    if numbers.ndim != 1:
        raise ColumnError(f"{name} has shape {numbers.shape}; expected one number per row")
    valid = ~np.isinf(numbers) if missing else np.isfinite(numbers)
    if not valid.all():
        row = int(np.argmin(valid))
        raise ColumnError(f"{name} is {numbers[row]}; expected a finite number", row)
    return numbers


def _number(value: Any, name: str, row: int, missing: bool) -> float:
    if missing and _is_missing(value):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ColumnError(f"{name} is {value!r}; expected a finite number", row) from None


def _frames(
    table: Mapping[str, Any], chosen: Mapping[str, str], rate: float
) -> Int[np.ndarray, " R"]:
    name = chosen.get("frame", chosen.get("time", ""))
    values = _numbers(table[name], name)
    if "frame" in chosen:
        frames, wrong = values, (values != np.floor(values)) | (np.abs(values) >= LARGEST)
        expected = "a whole number"
    else:
        # Relative to the first time, so that times of day need not be whole numbers of frames.
        start = float(values.min())
        steps = (values - start) * rate
        frames = round(start * rate) + np.round(steps)
        wrong = (np.abs(steps - np.round(steps)) > JITTER) | (np.abs(frames) >= LARGEST)
        expected = (
            f"{start} s and a whole number of {1.0 / rate:.6g} s, as rate is {rate:g} Hz; give the "
            "rate at which the rows were recorded, or interpolate them"
        )
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ColumnError(f"{name} is {values[row]:.12g}; expected {expected}", row)
    return frames.astype(np.int64)


def _texts(values: Any, name: str) -> list[str]:
    """Return a column as texts without blanks around them; none may be missing."""
    found = []
    for row, value in enumerate(np.asarray(values, dtype=object).tolist()):
        if _is_missing(value):
            raise ColumnError(f"{name} is missing; expected a name or a number", row)
        found.append(str(value).strip())
    return found


def _is_missing(value: Any) -> bool:
    """Whether a cell is empty, in any of the ways in which tables say so."""
    return value is None or str(value).strip() in ("", "nan", "NaN", "<NA>", "NaT")


def _agents(values: Any, name: str) -> list[str]:
    """Return ids: whole numbers without a decimal point, also where a gap made them floats."""
    array = np.asarray(values)
    if array.dtype.kind == "f":
        whole = (array == np.floor(array)) & (np.abs(array) < LARGEST)
        if not whole.all():
            row = int(np.argmin(whole))
            raise ColumnError(f"{name} is {array[row]}; expected a name or a whole number", row)
        array = array.astype(np.int64)
    return _texts(array, name)


def _kinds(values: Any, name: str) -> list[str]:
    kinds = _texts(values, name)
    for row, kind in enumerate(kinds):
        meant = meant_kind(kind)
        if meant is not None:
            raise ColumnError(f"{name} is {kind!r}; expected {meant!r}", row)
    return kinds
