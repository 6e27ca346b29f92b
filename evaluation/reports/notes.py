"""Output of studies, kept for a page instead of shown on a terminal."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluation.reports.terminal import FILE_WIDTH


@dataclass(frozen=True)
class Shown:
    """A table as text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: tuple[bool, ...]
    """Which columns are aligned to the right."""


class Notes(Console):
    """A console whose tables and paragraphs are kept in `kept`, in order."""

    def __init__(self) -> None:
        super().__init__(file=io.StringIO(), width=FILE_WIDTH)
        self.kept: list[Shown | str] = []

    def print(self, *objects: Any, **options: Any) -> None:
        """Keep tables, and everything else as a paragraph."""
        for thing in objects:
            if isinstance(thing, Table):
                self.kept.append(_shown(thing))
            else:
                markup = options.get("markup", True)
                self.kept.append(_plain(thing) if markup else str(thing))


def _plain(thing: Any) -> str:
    """Text without rich's markup."""
    return Text.from_markup(thing).plain if isinstance(thing, str) else str(thing)


def _shown(table: Table) -> Shown:
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    return Shown(
        _plain(table.title or ""),
        tuple(_plain(column.header) for column in table.columns),
        tuple(zip(*columns, strict=True)),
        tuple(column.justify == "right" for column in table.columns),
    )
