"""Compiled programs that a process keeps."""

from __future__ import annotations

import ctypes
import gc
import os
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import ParamSpec, cast

P = ParamSpec("P")

MOST_MEMORY_MAPS = 40_000
"""Memory maps of a process above which its programs are forgotten. Each program holds dozens, and a
study of many games compiles some for every game; Linux grants a process 65530, and XLA ends it when
there are no more."""
MOST_MEMORY = 4.0
"""Resident memory of a process, GB, above which its programs are forgotten."""
SECONDS = 10.0
"""Between two counts: reading the maps takes as long as a short trial."""

_warm_ups: list[Callable[[], None]] = []
_counted = [0.0]


def until_forgotten(function: Callable[P, None]) -> Callable[P, None]:
    """Called once with the same arguments, and again after programs have been forgotten."""
    cached = lru_cache(maxsize=256)(function)
    _warm_ups.append(cached.cache_clear)
    return cast(Callable[P, None], cached)


def forget_if_many(
    most: int = MOST_MEMORY_MAPS, most_memory: float = MOST_MEMORY, seconds: float = SECONDS
) -> bool:
    """Between trials: forget programs, and that they were warmed up, where there are too many.

    Args:
        most: memory maps above which they are forgotten.
        most_memory: resident memory (GB) above which they are forgotten.
        seconds: since the last count, before which nothing is counted.

    Returns:
        Whether they were forgotten.
    """
    now = time.monotonic()
    maps = Path("/proc/self/maps")
    if now - _counted[0] < seconds or not maps.exists():
        return False
    _counted[0] = now
    if maps.read_bytes().count(b"\n") <= most and _resident() <= most_memory:
        return False
    from foresight_env.compilation import forget_compilations

    forget_compilations()
    for clear in _warm_ups:
        clear()
    gc.collect()
    _return_memory()
    return True


def _return_memory() -> None:
    """Return freed memory to the system, where the C library can (glibc)."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def _resident() -> float:
    """Resident memory of this process, GB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9
