"""Workers that run trials: this process, several on this machine, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from evaluation.execution.pilots import Pilots
from evaluation.execution.process import prepare_worker
from evaluation.execution.store import Row, Trial
from evaluation.execution.trial import Attempt
from foresight_env.extras import require

Workers = int | str | None
"""Processes on this machine (None: one per core; 0: this one), or a Dask scheduler's address."""


def results(
    attempt: Attempt, trials: Sequence[Trial], workers: Workers, programs: Sequence[str] = ()
) -> Generator[Row]:
    """Rows in the order in which they are finished; closed early, it stops what is running.

    `programs`: columns of a trial that decide which compiled programs it needs; processes of this
    machine compile each once (module `pilots`).
    """
    if isinstance(workers, str):
        require("cluster", "--cluster")
        from evaluation.execution.dask import cluster_results

        return cluster_results(attempt, trials, workers)
    count = available_workers() if workers is None else workers
    if count == 0 or len(trials) < 2:
        return (attempt(trial) for trial in trials)
    return _process_results(attempt, Pilots(trials, programs), min(count, len(trials)))


def available_workers() -> int:
    """Processes that may run at once on this machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _process_results(attempt: Attempt, pilots: Pilots, count: int) -> Generator[Row]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, initializer=prepare_worker) as pool:
        running = {pool.submit(attempt, trial): trial for trial in pilots.next_pilot()}
        try:
            while running:
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    trial, row = running.pop(future), future.result()
                    todo = pilots.finished(trial)
                    while len(running) + len(todo) < count and (more := pilots.next_pilot()):
                        todo += more
                    running |= {pool.submit(attempt, released): released for released in todo}
                    yield row
        except BrokenProcessPool as error:
            raise OSError(
                "a worker process was killed (out of memory?); finished trials are kept, run the "
                "same command again or with fewer --workers"
            ) from error
        except BaseException:
            # An interrupt ends the study now, not when all that waits has been run.
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
