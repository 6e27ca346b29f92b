"""Shared by all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

# Compiling games is most of the suite's time, and takes a third of it so. What XLA makes by default
# is tested too (tests/equilibrium/test_compilation.py). Read when JAX first looks for devices.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
)

import jax
import matplotlib
import pytest

from evaluation.execution.compilation import forget_if_many

# No test opens a window.
matplotlib.use("Agg")

# As the Makefile does, for those who call pytest themselves: compiled programs are kept, by this
# process and those that tests start.
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(__file__).resolve().parents[1] / ".cache" / "jax")
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update(
    "jax_persistent_cache_min_compile_time_secs",
    float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"]),
)

MOST_MEMORY_MAPS = 20_000
"""See `evaluation.execution.compilation`; the next file may compile much."""


@pytest.fixture(scope="module", autouse=True)
def forget_compiled_programs() -> Iterator[None]:
    """What a file's tests compiled is not kept for ever: see `MOST_MEMORY_MAPS`."""
    yield
    forget_if_many(MOST_MEMORY_MAPS, seconds=0.0)
