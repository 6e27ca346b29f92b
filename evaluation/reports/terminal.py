"""Console that tables are printed on."""

from __future__ import annotations

import os

from rich.console import Console

FILE_WIDTH = 200
"""Columns of output that goes to a file or a pipe, which has no width: room for the
widest table."""


def terminal() -> Console:
    """Standard output, as wide as its window; `COLUMNS` overrules."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        return Console(width=FILE_WIDTH)
    return console
