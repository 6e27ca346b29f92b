"""Fits on a machine with one core, where jaxlib 0.10 lacks LAPACK within loops."""

import os
import subprocess
import sys

import pytest

ON_ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from tests.inverse.test_estimate import fit, played
assert fit(played()[:5]).status == 0
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity on this system")
def test_one_core_is_enough():
    """XLA compiles in another way there, and some LAPACK calls not at all (jaxlib 0.10)."""
    run = subprocess.run([sys.executable, "-c", ON_ONE_CORE], capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
