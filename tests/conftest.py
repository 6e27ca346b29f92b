"""Shared by all tests."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

# Compiling games is most of the suite's time, and takes a third of it so. What XLA makes by default
# is tested too (tests/equilibrium/test_compilation.py). Read when JAX first looks for devices.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false "
    # Both workers compile: more threads for one program only add up its parts.
    "--xla_cpu_parallel_codegen_split_count=1",
)

# Before the library: what is first imported by a module that jaxtyping instruments is read without
# Python's cache of compiled modules.
import jax  # noqa: F401
import matplotlib
import pytest
import scipy.stats  # noqa: F401

from evaluation.execution.compilation import forget_if_many
from foresight_env.compilation import enable_compilation_cache

# Tracing makes millions of objects, among them no cycles worth an eighth of the suite's time.
gc.freeze()
gc.set_threshold(50_000, 20, 100)

# No test opens a window.
matplotlib.use("Agg")

# Compiled programs are kept, by this process and those that tests start.
enable_compilation_cache(
    os.environ.get("JAX_COMPILATION_CACHE_DIR")
    or Path(__file__).resolve().parents[1] / ".cache" / "jax"
)

MOST_MEMORY_MAPS = 20_000
"""See `evaluation.execution.compilation`; the next file may compile much."""
MOST_MEMORY = 1.4
"""Resident memory of a worker, GB, above which it forgets what its tests compiled."""


@pytest.fixture(autouse=True)
def forget_compiled_programs() -> Iterator[None]:
    """Forget the programs of earlier tests where they take too much memory."""
    yield
    forget_if_many(MOST_MEMORY_MAPS, MOST_MEMORY, seconds=5.0)
