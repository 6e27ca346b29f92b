"""Run independent trials on local processes, with progress; a failing trial becomes a row."""

from __future__ import annotations

import multiprocessing
import os
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from evaluation.store import Row, Store

Trial = dict[str, Any]
"""Arguments of one trial; holds at least the store's key columns."""


def attempt(function: Callable[..., Row], trial: Trial, key: tuple[str, ...]) -> Row:
    """The trial's row, or a row that says what went wrong."""
    try:
        return {**{k: trial[k] for k in key}, **function(**trial), "error": ""}
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        told = (
            f"{type(error).__name__}: {error} ({os.path.basename(where.filename)}:{where.lineno})"
        )
        return {**{k: trial[k] for k in key}, "error": told}


def available_workers() -> int:
    """Processes that may run at once on this machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def single_threaded() -> None:
    """Keep a worker's numerical libraries on one thread: the workers share the cores."""
    os.environ["OMP_NUM_THREADS"] = "1"
    # Not XLA_FLAGS: those are part of a compiled program's cache key, and this process would
    # compile anew what its workers have compiled.
    os.environ["PJRT_NPROC"] = "1"


def run_trials(
    function: Callable[..., Row],
    trials: Sequence[Trial],
    store: Store,
    *,
    workers: int | None = None,
    label: str,
    chunk: int = 4,
) -> list[Row]:
    """Run what `store` does not have yet and return the rows of `trials`.

    Rows are written `chunk` at a time, so that an interruption loses little. `workers`: None for
    one per core, 0 for this process.
    """
    finished = store.finished()
    todo = [t for t in trials if tuple(t[k] for k in store.key) not in finished]
    count = available_workers() if workers is None else workers
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
            if count == 0 or len(todo) < 2:
                for trial in todo:
                    done(attempt(function, trial, store.key))
            else:
                context = multiprocessing.get_context("spawn")
                with ProcessPoolExecutor(
                    min(count, len(todo)), context, initializer=single_threaded
                ) as pool:
                    futures = [pool.submit(attempt, function, t, store.key) for t in todo]
                    try:
                        for future in as_completed(futures):
                            done(future.result())
                    except BrokenProcessPool as error:
                        raise OSError(
                            "a worker process was killed (out of memory?); finished trials are "
                            "kept, run the same command again or with fewer --workers"
                        ) from error
                    except BaseException:
                        # An interrupt ends the study now, not when all that waits has been run.
                        pool.shutdown(wait=False, cancel_futures=True)
                        for process in multiprocessing.active_children():
                            process.terminate()
                        raise
        finally:
            store.append(pending)
    keys = {tuple(t[k] for k in store.key) for t in trials}
    return [row for row in store.rows() if tuple(row[k] for k in store.key) in keys]
