"""Timing: medians over repeats, and a yardstick that makes machines comparable.

The yardstick is the median time of a single-threaded 500 x 500 `numpy.linalg.solve` on the same
machine, just before the study. Every time is printed with its multiple of that.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]

SINGLE_THREAD = {
    name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
}

YARDSTICK = """
import time
import numpy as np
random = np.random.default_rng(0)
a, b = random.normal(size=(500, 500)) + 50.0 * np.eye(500), random.normal(size=500)
medians = []
for _ in range(5):  # the least of five: other work on the machine only lengthens them
    times = []
    for _ in range(20):
        begin = time.perf_counter()
        np.linalg.solve(a, b)
        times.append(time.perf_counter() - begin)
    medians.append(np.median(times))
print(min(medians))
"""


@dataclass(frozen=True)
class Yardstick:
    """The unit that times are compared with."""

    seconds: float

    @staticmethod
    def measure() -> Yardstick:
        """In a separate process: the number of threads is fixed when NumPy is imported."""
        run = subprocess.run(
            [sys.executable, "-c", YARDSTICK],
            env={**os.environ, **SINGLE_THREAD},
            capture_output=True,
            text=True,
            check=True,
        )
        return Yardstick(float(run.stdout))

    def formatted(self, seconds: float) -> str:
        """A time and its multiple of the yardstick."""
        unit = f"{seconds:.2f} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"
        return f"{unit} ({seconds / self.seconds:.3g} y)"

    @property
    def note(self) -> str:
        """Meaning of `y`."""
        return f"Yardstick y: {1e3 * self.seconds:.2f} ms."


def seconds_of(function: Callable[[], Any]) -> float:
    """Wall-clock seconds of one call."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def median_seconds(function: Callable[[], Any], repeats: int = 3) -> float:
    """Median over `repeats` calls."""
    return float(np.median([seconds_of(function) for _ in range(repeats)]))


class CompileTime(NamedTuple):
    """Seconds that a first call takes in a fresh process, without and from the persistent cache."""

    fresh: float
    cached: float

    @property
    def formatted(self) -> str:
        """For a table."""
        return f"{self.fresh:.1f} s, {self.cached:.1f} s"


def compile_seconds(kind: str, *arguments: str) -> CompileTime:
    """Measure a program of `benchmarks.compilation`."""
    with tempfile.TemporaryDirectory() as folder:
        cache = {
            "JAX_ENABLE_COMPILATION_CACHE": "true",
            "JAX_COMPILATION_CACHE_DIR": folder,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
        seconds = []
        for _ in range(2):  # the first process fills the cache for the second
            run = subprocess.run(
                [sys.executable, "-m", "benchmarks.compilation", kind, *arguments],
                cwd=ROOT,
                env={**os.environ, **cache},
                capture_output=True,
                text=True,
                check=True,
            )
            seconds.append(float(json.loads(run.stdout.splitlines()[-1])))
    return CompileTime(*seconds)


def processor() -> str:
    """Model of the processor, as far as the system reports it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
