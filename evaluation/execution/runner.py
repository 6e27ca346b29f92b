"""Run independent trials, with progress; a failing trial becomes a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

from evaluation.execution.local import Workers, results
from evaluation.execution.progress import progress
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
    programs: Sequence[str] = (),
) -> list[Row]:
    """Run what `store` does not have yet and return the rows of `trials`.

    Rows are written `chunk` at a time, so that an interruption loses little. `programs`: columns
    that decide which compiled programs a trial needs, so that a study compiles each once.
    """
    keys = {tuple(t[k] for k in store.key) for t in trials}
    before = _rows(store, keys)
    finished = {tuple(row[k] for k in store.key) for row in before}
    todo = [t for t in trials if tuple(t[k] for k in store.key) not in finished]
    failed = sum(bool(row["error"]) for row in before)
    pending: list[Row] = []
    with progress(label, len(trials), len(trials) - len(todo), failed) as shown:
        try:
            # Closed also when a row cannot be written: else workers would keep running.
            with closing(results(Attempt(function, store.key), todo, workers, programs)) as rows:
                for row in rows:
                    pending.append(row)
                    shown.advance(bool(row["error"]))
                    if len(pending) >= chunk:
                        store.append(pending)
                        pending.clear()
        finally:
            store.append(pending)
    return _rows(store, keys)


def _rows(store: Store, keys: set[tuple[object, ...]]) -> list[Row]:
    return [row for row in store.rows() if tuple(row[k] for k in store.key) in keys]
