"""Settings of a process that have to be made before JAX is loaded."""

from __future__ import annotations

import os
from pathlib import Path


def keep_compiled_programs() -> None:
    """Let JAX keep compiled programs between runs, unless the user has said where or whether."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "foresight_env" / "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")


def single_threaded() -> None:
    """Keep a worker's numerical libraries on one thread: the workers share the cores."""
    os.environ["OMP_NUM_THREADS"] = "1"
    # Not XLA_FLAGS: those are part of a compiled program's cache key, and this process would
    # compile again what its workers have compiled.
    os.environ["PJRT_NPROC"] = "1"
