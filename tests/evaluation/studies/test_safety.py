"""The safety study: its rows, fault, and tables."""

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from evaluation.reports.safety import print_safety
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, TIME_OUT
from evaluation.rollout.places import SETTINGS
from evaluation.rollout.setting import RunSetting
from evaluation.studies.safety import RECORDED, possible, setting_under, study, summarise


def row(ego, seed, ended, **others):
    return {
        "setting": "crowd-4",
        "surprise": "none",
        "ego": ego,
        "seed": seed,
        "error": "",
        "ended": ended,
        "at_fault": False,
        "time": 3.0,
        "time_limit": 10.0,
        "min_gap": 0.1,
        "cost": 5.0 + seed,
        "steps": 30,
        "interventions": 3 * (seed == 0),
        "failed_plans": 0,
        "failed_fits": 0,
        "latencies": [10.0] * 29 + [1000.0],
        **others,
    }


ROWS = [
    row("a", 0, COLLISION, at_fault=True),
    row("a", 1, COLLISION),
    row("a", 2, OFF_ROAD),
    row("a", 3, REACHED),
    row("a", 4, TIME_OUT, time=10.0),
    {"setting": "crowd-4", "surprise": "none", "ego": "a", "seed": 5, "error": "ValueError: no"},
]


def test_counts_of_an_ego():
    found = summarise(ROWS, "crowd-4", "none", "a")
    assert (found.episodes, found.failed) == (5, 1)
    assert (found.collisions, found.at_fault, found.off_road, found.reached) == (2, 1, 1, 1)
    assert found.interventions == pytest.approx(3 / 150)
    # Of the two that were not harmed.
    assert found.cost.mean == pytest.approx(8.5)
    # Four did not arrive.
    assert found.time.mean == pytest.approx((4 * 10.0 + 3.0) / 5)
    assert found.latency_p99 > 500.0
    assert summarise(ROWS, "crowd-4", "idm", "a") is None


def test_the_table_shows_harm_and_its_price():
    console = Console(width=120, record=True, file=StringIO())
    print_safety(console, ROWS, ("crowd-4",), ("none", "idm"), ("a",))
    text = console.export_text()
    assert "crowd-4, n 5" in text
    assert "2 (1), 1 off; 1" in text
    assert "2.0 %" in text
    assert "ValueError: no" in text
    # Walkers do not drive by IDM.
    assert "idm" not in text


def test_settings_and_surprises():
    assert possible("merge", "idm")
    assert not possible("crowd-2", "idm")
    found = setting_under("merge", "idm", safety_filter=False)
    assert found == RunSetting("driving", "merge", surprise="idm", safety_filter=False)
    assert found.behaviour_of_others == "idm"
    true = found.true_gammas({"gamma": np.array([0.9, 0.8, 0.7])})
    assert np.isnan(true).tolist() == [False, True, True]


def test_a_study_runs_and_is_resumed(monkeypatch, tmp_path):
    short = RunSetting("crosswalk", planning_horizon=10)
    monkeypatch.setitem(SETTINGS, "short", short)
    surprises = ("none", "idm", "dropouts")
    rows = study(tmp_path, ("short",), surprises, ("constant-velocity",), range(2), workers=0)
    assert sorted(r["surprise"] for r in rows) == ["dropouts"] * 2 + ["none"] * 2
    assert not any(r["error"] for r in rows)
    again = study(tmp_path, ("short",), surprises, ("constant-velocity",), range(2), workers=0)
    assert again == rows


def test_a_study_among_recorded_agents(tmp_path):
    egos, surprises = ("constant-velocity",), ("none", "idm")
    rows = study(tmp_path, (RECORDED,), surprises, egos, range(5), workers=0)
    # As many as the made recording has; no highway-env vehicles among them.
    assert [(r["surprise"], r["seed"]) for r in rows] == [("none", 0), ("none", 1), ("none", 2)]
    assert not any(r["error"] for r in rows)
    with pytest.raises(ValueError, match="scenario: is 'recorded'"):
        setting_under(RECORDED, "none").make()
    console = Console(width=120, record=True, file=StringIO())
    print_safety(console, rows, (RECORDED,), surprises, egos)
    assert "ignore the ego" in console.export_text()
