"""Checks of the ranges that a scenario draws its episodes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np


def check_ranges(ranges: Any, pairs: Sequence[str], shifts: Mapping[str, float]) -> None:
    """Check that every draw from `ranges` is a legal episode.

    Args:
        ranges: fields by name.
        pairs: fields that hold (lowest, highest); all but "gamma" are above 0.
        shifts: fields that hold a largest shift, with the most that they may be.

    Raises:
        ValueError: a field is no such pair or number; the message names it.
    """
    for name in pairs:
        pair = getattr(ranges, name)
        positive = name != "gamma"
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError) as error:
            raise ValueError(f"ranges.{name}: is {pair!r}; expected (lowest, highest)") from error
        if not (0.0 <= low <= high < np.inf) or (positive and low == 0.0):
            least = "above 0" if positive else "at least 0"
            raise ValueError(
                f"ranges.{name}: is {pair!r}; expected lowest <= highest, finite and {least}"
            )
    for name, most in shifts.items():
        shift = getattr(ranges, name)
        if not isinstance(shift, Real) or not 0.0 <= float(shift) < np.inf:
            raise ValueError(f"ranges.{name}: is {shift!r}; expected a finite number, at least 0")
        if float(shift) > most:
            raise ValueError(f"ranges.{name}: is {shift!r}; at most {most}")
