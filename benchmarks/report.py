"""Results of a study: a table for the terminal and for Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

Cell = str | int | float
TableRow = dict[str, Cell]


@dataclass(frozen=True)
class Arguments:
    """Command-line arguments of a benchmark."""

    console: Console
    quick: bool
    data: Path | None
    """Folder with recordings, for the study that needs one."""
    reference: Path | None = None
    """Folder with the reference implementation's raw results, drawn next to ours where given."""


@dataclass(frozen=True)
class Result:
    """One table with a sentence or two on how to read it."""

    title: str
    note: str
    rows: Sequence[TableRow]

    def show(self, console: Console) -> Result:
        """Print and return itself."""
        if not self.rows:
            console.print(f"{self.title}. {self.note}")
            return self
        table = Table(title=self.title, caption=self.note, caption_justify="left")
        for name in self.rows[0]:
            table.add_column(
                escape(name), justify="right" if number_like(self.rows[0][name]) else "left"
            )
        for row in self.rows:
            table.add_row(*(formatted(value) for value in row.values()))
        console.print(table)
        return self

    def markdown(self) -> str:
        """A section of the document."""
        lines = [f"## {self.title}", "", self.note, ""]
        if self.rows:
            names = list(self.rows[0])
            lines += [
                "| " + " | ".join(names) + " |",
                "|"
                + "|".join("---:" if number_like(self.rows[0][n]) else "---" for n in names)
                + "|",
            ]
            lines += [
                "| " + " | ".join(formatted(v) for v in row.values()) + " |" for row in self.rows
            ]
            lines.append("")
        return "\n".join(lines)


def number_like(value: Cell) -> bool:
    """Whether the cell belongs on the right: numbers, and texts that begin with one."""
    return not isinstance(value, str) or value[:1].isdigit()


def formatted(value: Cell) -> str:
    """A cell as text: three significant digits are what repeats support."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
