"""Tests, in the same folders as what they test; helpers in `tests.support`."""

# `--jaxtyping-packages` imports the top-level package alone and then reads attributes.
from tests.support import runtime_types as runtime_types
