"""Failed trials, in words."""

from __future__ import annotations

from collections.abc import Sequence

from evaluation.execution.store import Row


def errors_of(rows: Sequence[Row]) -> list[str]:
    """Return the errors of the trials that failed, in the order of the rows."""
    return [str(row["error"]) for row in rows if row["error"]]


def failed(errors: Sequence[str], what: str = "trial") -> str:
    """Return how many trials failed and the first error: "2 trials failed; first: <error>".

    Args:
        errors: One per failed trial.
        what: What a trial is, in the singular.
    """
    count = f"{len(errors)} {what}{'' if len(errors) == 1 else 's'} failed"
    return f"{count}; first: {errors[0]}" if errors else count
