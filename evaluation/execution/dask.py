"""Trials on a Dask cluster (the extra `cluster`; imported only when one is used)."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from typing import Any

from distributed import Client, as_completed
from distributed.diagnostics.plugin import WorkerPlugin

from evaluation.execution.code import code_digest
from evaluation.execution.process import prepare_worker
from evaluation.execution.store import Row, Trial
from evaluation.execution.trial import Attempt
from foresight_env.compilation import enable_compilation_cache

PATIENCE = 30.0
"""How long a scheduler, and then a first worker, is waited for, s."""


class _Prepared(WorkerPlugin):
    """Configure workers as local worker processes are, also those that join later."""

    name = "foresight_env"

    def setup(self, worker: Any) -> None:
        enable_compilation_cache()
        prepare_worker()


def cluster_results(attempt: Attempt, trials: Sequence[Trial], address: str) -> Generator[Row]:
    """Rows in the order in which they are finished.

    A trial whose worker dies is run on another one. One that has cost several workers their lives
    is a row with that error. `OSError`: there is no cluster, or it went away.
    """
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise OSError(f"--cluster: no Dask scheduler answers at {address} ({error})") from error
    with client:
        _check(client, address)
        client.register_plugin(_Prepared())
        futures = client.map(attempt, trials, pure=False, key="trial")
        of = dict(zip(futures, trials, strict=True))
        for future in as_completed(futures, loop=client.loop):
            try:
                row = future.result()
            except CancelledError as error:
                raise OSError(
                    f"--cluster: {address} went away; finished trials are kept, run the same "
                    "command again"
                ) from error
            except Exception as error:  # KilledWorker, or a module that the worker does not have
                row = attempt.failed(of[future], f"{type(error).__name__}: {error}")
            yield row
            future.release()


def _check(client: Client, address: str) -> None:
    """Workers are there, have one thread each and the same code as this process."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as error:
        raise OSError(
            f"--cluster: {address} has no workers; start some: dask worker {address} --nthreads 1"
        ) from error
    threads = max(client.nthreads().values())
    if threads > 1:
        raise OSError(
            f"--cluster: a worker of {address} has {threads} threads; start them with --nthreads 1"
        )
    try:
        codes = set(client.run(code_digest).values())
    except ImportError as error:
        raise OSError(f"--cluster: a worker of {address} lacks this library ({error})") from error
    if codes != {code_digest()}:
        raise OSError(
            f"--cluster: workers of {address} have other code of foresight_env "
            f"({', '.join(sorted(codes))}); expected {code_digest()}: install the same version "
            "there and restart the workers"
        )
