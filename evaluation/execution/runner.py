"""Run independent trials, with progress; a failing trial becomes a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from evaluation.execution.local import Workers, results
from evaluation.execution.store import Row, Store, Trial
from evaluation.execution.trial import Attempt


def run_trials(
    function: Callable[..., Row],
    trials: Sequence[Trial],
    store: Store,
    *,
    workers: Workers = None,
    label: str,
    chunk: int = 4,
) -> list[Row]:
    """Run what `store` does not have yet and return the rows of `trials`.

    Rows are written `chunk` at a time, so that an interruption loses little.
    """
    finished = store.finished()
    todo = [t for t in trials if tuple(t[k] for k in store.key) not in finished]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    pending: list[Row] = []
    with Progress(*columns) as progress:
        task = progress.add_task(label, total=len(trials), completed=len(trials) - len(todo))

        def done(row: Row) -> None:
            pending.append(row)
            progress.advance(task)
            if len(pending) >= chunk:
                store.append(pending)
                pending.clear()

        try:
            # Closed also when a row cannot be written: else workers would go on.
            with closing(results(Attempt(function, store.key), todo, workers)) as rows:
                for row in rows:
                    done(row)
        finally:
            store.append(pending)
    keys = {tuple(t[k] for k in store.key) for t in trials}
    return [row for row in store.rows() if tuple(row[k] for k in store.key) in keys]
