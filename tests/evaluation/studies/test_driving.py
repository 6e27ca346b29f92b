"""Summaries of the driving study's rows."""

import pytest

from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, TIME_OUT, ending
from evaluation.studies.driving import paired, summarise, time_to_goal


def row(ego, seed, ended, time, gap, **others):
    return {
        "scene": "merge",
        "others": "idm",
        "ego": ego,
        "seed": seed,
        "error": "",
        "ended": ended,
        "at_fault": False,
        "time": time,
        "time_limit": 8.0,
        "min_gap": gap,
        "min_distance": gap + 4.0,
        "rms_acceleration": 1.0,
        "rms_jerk": 2.0,
        "rms_lateral": 3.0,
        "interventions": 2,
        "failed_plans": 1,
        "failed_fits": 0,
        "oracle_failures": 0,
        "latencies": [1.0, 3.0],
        **others,
    }


ROWS = [
    row("infer-gamma", 0, REACHED, 5.0, 2.0),
    row("infer-gamma", 1, TIME_OUT, 8.0, 1.0),
    row("infer-gamma", 2, COLLISION, 3.0, -0.5, at_fault=True),
    row("idm", 0, COLLISION, 2.0, -1.0),
    row("idm", 1, REACHED, 6.0, 3.0),
    {"scene": "merge", "others": "idm", "ego": "idm", "seed": 2, "error": "ValueError: no"},
]


def test_a_summary_by_hand():
    found = summarise(ROWS, "merge", "idm", "infer-gamma")
    assert found.episodes == 3
    assert (found.ends[COLLISION], found.ends[REACHED], found.ends[TIME_OUT]) == (1, 1, 1)
    assert found.faults == 1
    assert found.failed == 0
    assert found.least_gap == -0.5
    # Neither a collision nor a time-out is a quick arrival.
    assert found.time.mean == pytest.approx((5.0 + 8.0 + 8.0) / 3.0)
    assert found.failed_plans == 3
    assert summarise(ROWS, "merge", "idm", "idm").failed == 1
    assert summarise(ROWS, "left_turn", "idm", "idm") is None
    assert time_to_goal(ROWS[3]) == 8.0


def test_pairs_are_seeds_that_both_finished():
    found = paired(ROWS, "merge", "idm", "infer-gamma", "idm")
    assert found.seeds == 2
    assert found.gap.mean == pytest.approx(((2.0 + 1.0) + (1.0 - 3.0)) / 2.0)
    assert found.time.mean == pytest.approx(((5.0 - 8.0) + (8.0 - 6.0)) / 2.0)
    assert found.collisions == -1
    assert paired(ROWS, "merge", "idm", "infer-gamma", "oracle") is None


def test_harm_counts_before_success():
    info = {"collision": False, "off_road": False, "is_success": True}
    assert ending(info) == REACHED
    assert ending({**info, "off_road": True}) == OFF_ROAD
    assert ending({**info, "off_road": True, "collision": True}) == COLLISION
    assert ending({**info, "is_success": False}) == TIME_OUT
