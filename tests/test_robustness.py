"""A short form of the hour of rough use (benchmarks/robustness)."""

from benchmarks.robustness import rough_use, uses
from foresight_env.envs.registration import VECTOR
from foresight_env.names import SCENARIOS


def test_nothing_breaks():
    tally, memory = rough_use(seconds=0.0, least=30, seed=1)
    assert tally.violations == []
    assert {name.partition(":")[0] for name in tally.done} == set(uses())
    assert tally.refused.total() > 0
    assert not any(value <= 0.0 for value in memory)
    assert set(tally.episodes) == {
        *(f"foresight/{name}-v0, {form}" for name in SCENARIOS for form in ("parallel", "AEC")),
        *(f"foresight/{name.capitalize()}-v0" for name in SCENARIOS),
        *(f"foresight/{name.capitalize()}-v0, vector" for name in VECTOR),
    }
