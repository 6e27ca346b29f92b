"""Settings shared by the evaluation's tests."""

from pathlib import Path

import jax

CACHE = Path(__file__).parents[2] / ".cache" / "jax"
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
