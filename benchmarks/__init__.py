"""How fast and how accurate: one study per module, `python -m benchmarks` runs them."""
