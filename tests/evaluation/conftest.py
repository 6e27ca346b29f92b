"""Settings shared by the evaluation's tests."""

import sys
from pathlib import Path

import jax

sys.path.insert(0, str(Path(__file__).parent))

CACHE = Path(__file__).parents[2] / ".cache" / "jax"
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
