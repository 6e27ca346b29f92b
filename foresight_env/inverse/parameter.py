"""Identity of one estimated number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ParameterKind = Literal["theta", "gamma", "initial_state"]


@dataclass(frozen=True)
class Parameter:
    """One entry of an estimate's parameter vector; `str` gives a name such as `goal[0] of 1`."""

    player: int
    kind: ParameterKind
    entry: str = ""
    """Name of the entry of `theta`; empty for other kinds."""
    index: int | None = None
    """Place in the flattened entry or in the state vector; None of numbers."""

    def __str__(self) -> str:
        place = "" if self.index is None else f"[{self.index}]"
        return f"{self.entry or self.kind}{place} of {self.player}"
