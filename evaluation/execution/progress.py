"""Progress of a study: a bar on a terminal, lines on standard error elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import rich
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

PERIOD = 10.0
"""Between two lines, s."""


class Counter(Protocol):
    """Counts finished trials."""

    def advance(self, failed: bool) -> None:
        """Count one more trial."""
        ...


@contextmanager
def progress(label: str, total: int, completed: int, failed: int) -> Iterator[Counter]:
    """Show progress until the end of the context.

    Args:
        label: Name of the study.
        total: Trials.
        completed: Trials that have a row already.
        failed: Failed ones of these.
    """
    console = rich.get_console()
    if console.is_terminal or console.is_jupyter:
        with _Bar(label, total, completed) as bar:
            yield bar
    else:
        with _Lines(label, total, completed, failed) as lines:
            yield lines


class _Bar:
    """A progress bar on standard output."""

    def __init__(self, label: str, total: int, completed: int) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._task = self._bar.add_task(label, total=total, completed=completed)

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def advance(self, failed: bool) -> None:
        self._bar.advance(self._task)


class _Lines:
    """A line on standard error every `PERIOD` seconds and at the end."""

    def __init__(self, label: str, total: int, completed: int, failed: int) -> None:
        self._label, self._total = label, total
        self._before, self._completed, self._failed = completed, completed, failed
        self._begin = time.monotonic()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._repeat, daemon=True)

    def __enter__(self) -> _Lines:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()
        self._print()

    def advance(self, failed: bool) -> None:
        self._completed += 1
        self._failed += failed

    def _repeat(self) -> None:
        while not self._end.wait(PERIOD):
            if self._completed < self._total:  # the last line comes at the end
                self._print()

    def _print(self) -> None:
        seconds = time.monotonic() - self._begin
        print(self.line(seconds), file=sys.stderr, flush=True)

    def line(self, seconds: float) -> str:
        """The line after so many seconds."""
        done, left = self._completed - self._before, self._total - self._completed
        parts = [
            f"{self._label}: {self._completed} of {self._total} trials",
            f"{self._failed} failed",
            f"{_clock(seconds)} elapsed",
        ]
        if done and left:
            parts.append(f"about {_clock(seconds / done * left)} left")
        return ", ".join(parts)


def _clock(seconds: float) -> str:
    """Minutes and seconds, or hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
