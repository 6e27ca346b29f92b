"""Tables of lines, each a dictionary of cells by column: for the terminal and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

Line = dict[str, str | int]
"""Of a table: cells by column."""


def table_of(title: str, lines: Sequence[Line]) -> Table:
    """Return a table for the terminal; the first column is aligned to the left. At least a line."""
    table = Table(title=escape(title))
    for k, name in enumerate(lines[0]):
        table.add_column(escape(name), justify="right" if k else "left")
    for line in lines:
        table.add_row(*(escape(str(value)) for value in line.values()))
    return table


def markdown_of(lines: Sequence[Line]) -> list[str]:
    """Return the lines of the same table as Markdown. At least a line."""
    return markdown_table(tuple(lines[0]), [[str(cell) for cell in e.values()] for e in lines])


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table, and a blank one; an empty cell is a dash."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return ["| " + " | ".join(cell or "-" for cell in line) + " |" for line in lines] + [""]
