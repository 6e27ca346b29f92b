"""Shared by all tests."""

import matplotlib

# No test opens a window.
matplotlib.use("Agg")
