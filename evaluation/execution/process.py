"""Settings of a process that have to be made before JAX is loaded."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack


def single_threaded() -> None:
    """Keep a worker's numerical libraries on one thread: the workers share the cores."""
    os.environ["OMP_NUM_THREADS"] = "1"
    # Not XLA_FLAGS: those are part of a compiled program's cache key, and this process would
    # compile again what its workers have compiled.
    os.environ["PJRT_NPROC"] = "1"


def prepare_worker() -> None:
    """Prepare a process that runs trials: one thread, and a line where it compiles for long."""
    single_threaded()
    from foresight_env.compilation import announce_compilation

    _for_life.enter_context(
        announce_compilation(lambda line: print(f"foresight: {line}", file=sys.stderr, flush=True))
    )


_for_life = ExitStack()
"""Contexts of a worker process, which end with it."""
