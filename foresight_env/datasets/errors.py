"""The one error that reading a recording can raise."""

import os
from pathlib import Path

__all__ = ["RecordingError"]


class RecordingError(ValueError):
    """A recorded file cannot be read as the trajectory that it claims to be.

    The message reads ``<file>:<line>: what was wrong; what would be right``. Lines count from 1,
    as an editor counts them, and the header is a line. Where a fault belongs to no line (a file
    that does not exist, for example), the line is absent.

    Attributes:
        file: the file at fault.
        line: its line, or None.
    """

    def __init__(self, file: str | os.PathLike[str], line: int | None, problem: str) -> None:
        """Build the message from the file, its line and the problem with its remedy."""
        self.file = Path(file)
        self.line = line
        self.problem = problem
        place = f"{self.file}" if line is None else f"{self.file}:{line}"
        super().__init__(f"{place}: {problem}")

    def __reduce__(self) -> tuple[type["RecordingError"], tuple[Path, int | None, str]]:
        """Rebuild from the three arguments, so that the error survives a process pool."""
        return type(self), (self.file, self.line, self.problem)
