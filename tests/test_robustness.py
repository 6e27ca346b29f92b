"""A short form of the hour of rough use (benchmarks/robustness.py)."""

from benchmarks.robustness import rough_use, uses


def test_nothing_breaks():
    tally, memory = rough_use(seconds=0.0, least=150, seed=1)
    assert tally.violations == []
    kinds = {name.split(",")[0] for name in tally.done}
    assert {name.split(",")[0].removesuffix("s") for name in uses()} <= {
        kind.removesuffix("s") for kind in kinds
    }
    assert tally.refused.total() > 0
    assert all(value > 0.0 for value in memory)
