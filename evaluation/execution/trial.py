"""One trial, which ends in a row whatever happens."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from evaluation.execution.compilation import forget_if_many
from evaluation.execution.store import Row, Trial


@dataclass(frozen=True)
class Attempt:
    """Runs a trial, here or in another process; does not raise."""

    function: Callable[..., Row]
    """From a trial's arguments to its row without the key."""
    key: tuple[str, ...]
    """Columns that identify a trial."""

    def __call__(self, trial: Trial) -> Row:
        """The trial's row, or a row that says what went wrong."""
        forget_if_many()
        try:
            return {**self._key(trial), **self.function(**trial), "error": ""}
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{os.path.basename(where.filename)}:{where.lineno}"
            return self.failed(trial, f"{type(error).__name__}: {error} ({place})")

    def failed(self, trial: Trial, message: str) -> Row:
        """The row of a trial that failed."""
        return {**self._key(trial), "error": message}

    def _key(self, trial: Trial) -> Row:
        return {name: trial[name] for name in self.key}
