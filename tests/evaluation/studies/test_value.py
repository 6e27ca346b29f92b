"""Summaries of the value-of-information study's rows."""

from io import StringIO

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from evaluation.execution.store import Store
from evaluation.reports.page import write_report
from evaluation.reports.value import print_value, value_figure
from evaluation.rollout.clairvoyant import CLAIRVOYANT, Clairvoyant
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED, TIME_OUT
from evaluation.rollout.places import SETTINGS
from evaluation.rollout.setting import RunSetting
from evaluation.studies import value
from evaluation.studies.value import BASELINE, KEY, study
from evaluation.studies.value_summary import compare, share


def row(ego, seed, ended, cost, time=3.0, **others):
    return {
        "setting": "crowd",
        "ego": ego,
        "seed": seed,
        "error": "",
        "ended": ended,
        "time": time,
        "time_limit": 10.0,
        "cost": cost,
        **others,
    }


SEEDS = range(10)
ROWS = [
    # The baseline collides on two thirds of the seeds; cheaply, since its episodes end early.
    *(row(BASELINE, s, COLLISION if s < 6 else REACHED, 1.0 if s < 6 else 10.0) for s in SEEDS),
    *(row(CLAIRVOYANT, s, REACHED, 8.0 - 0.1 * s) for s in SEEDS),
    *(row("infer-gamma", s, OFF_ROAD if s < 2 else REACHED, 9.0 - 0.05 * s) for s in SEEDS),
    *(row("late", s, TIME_OUT, 10.0, 10.0) for s in SEEDS),
    {"setting": "crowd", "ego": "late", "seed": 11, "error": "ValueError: no"},
]


def test_costs_are_compared_where_neither_is_harmed():
    found = compare(ROWS, "crowd", CLAIRVOYANT)
    assert (found.seeds, found.unharmed) == (10, 4)
    gains = [10.0 - (8.0 - 0.1 * s) for s in range(6, 10)]
    assert found.cost.mean == pytest.approx(np.mean(gains))
    assert found.relative_cost == pytest.approx(np.mean(gains) / 10.0)
    assert found.harmed == (6, 0)
    # Six of six pairs that differ: 2 * 0.5^6.
    assert found.p_value == pytest.approx(2.0**-5)
    # Neither a collision nor a time-out is a quick arrival.
    assert found.time.mean == pytest.approx(0.6 * (10.0 - 3.0))
    assert compare(ROWS, "crowd", "late").time.mean == pytest.approx(0.4 * (3.0 - 10.0))


def test_shares_of_the_gap():
    found = share(ROWS, "crowd", "infer-gamma", CLAIRVOYANT)
    gains = sum(10.0 - (9.0 - 0.05 * s) for s in range(6, 10))
    gaps = sum(10.0 - (8.0 - 0.1 * s) for s in range(6, 10))
    assert found.cost.mean == pytest.approx(gains / gaps)
    assert found.cost.low <= found.cost.mean <= found.cost.high
    assert found.harm == pytest.approx((6 - 2) / 6)
    assert share(ROWS, "crowd", BASELINE, CLAIRVOYANT).cost.mean == 0.0
    assert share(ROWS, "crowd", CLAIRVOYANT, CLAIRVOYANT) == ((1.0, 1.0, 1.0), 1.0, 4)


def test_without_a_gap_there_is_no_share():
    assert share(ROWS, "crowd", "infer-gamma", "late") == (None, pytest.approx(4 / 6), 4)
    assert share(ROWS, "crowd", "infer-gamma", BASELINE) == (None, None, 4)


def test_nothing_in_common():
    assert compare(ROWS, "elsewhere", CLAIRVOYANT) is None
    always = [
        *(r for r in ROWS if r["ego"] == BASELINE),
        *(row("x", s, COLLISION, 1.0) for s in SEEDS),
    ]
    found = compare(always, "crowd", "x")
    assert found.cost is None
    assert np.isnan(found.relative_cost)
    assert share(always, "crowd", "infer-gamma", "x") == (None, None, 0)


def text_of(rows, egos, settings=("crowd",)):
    console = Console(width=200, record=True, file=StringIO())
    print_value(console, rows, settings, egos)
    return console.export_text()


def test_the_table_says_what_it_is_worth():
    text = text_of(ROWS, ("infer-gamma", BASELINE, "late"))
    assert "2.75 [2.65, 2.85], 28 %" in text
    assert "6 -> 0, p 0.031" in text
    assert "67 %" in text  # of collisions, by infer-gamma
    assert "1 of 31" not in text
    assert "ValueError: no" in text
    assert "2 of 10" in text
    assert "no episode finished" in text_of(ROWS, ("late", BASELINE), ("elsewhere",))


def test_a_share_of_fewer_seeds_than_the_gap_says_so():
    careless = [row("careless", s, COLLISION if s == 9 else REACHED, 9.0) for s in SEEDS]
    rows = [r for r in ROWS if not r["error"]] + careless
    assert share(rows, "crowd", "careless", CLAIRVOYANT).unharmed == 3
    text = text_of(rows, ("infer-gamma", BASELINE, "careless"))
    assert text.count("], n 3") == 1
    assert "cost, n 4" in text


def test_an_ego_without_a_finished_episode_hides_no_other():
    failed = {"setting": "crowd", "ego": "broken", "seed": 0, "error": "ValueError: no path"}
    text = text_of([*ROWS, failed], ("infer-gamma", "broken", BASELINE))
    assert "6 of 10" in text
    assert "ValueError" in text


def test_a_figure_and_a_report_of_rows(tmp_path):
    rows = [{**r, "setting": "crowd-3-short", "settings": "s"} for r in ROWS if not r["error"]]
    picture = value_figure(
        rows, ("crowd-3-short",), ("infer-gamma", CLAIRVOYANT), tmp_path / "x.png"
    )
    with Image.open(picture) as image:
        assert image.width > 1000
    Store(tmp_path / "rows", "value of information", {}, KEY).append(rows)
    text = write_report(tmp_path, episodes=0).read_text()
    assert "Value of knowing the others&#39; foresight" in text
    assert "6 -&gt; 0, p 0.031" in text
    assert (tmp_path / "figures" / "rows_value.pdf").exists()
    # An interrupted study may have the baseline alone.
    Store(tmp_path / "begun", "value of information", {}, KEY).append(rows[:10])
    assert "6 -&gt; 6, p 1" in write_report(tmp_path / "begun", episodes=0).read_text()


@pytest.fixture
def small(monkeypatch):
    """A setting that is run in a second, with a short search."""
    short = RunSetting("crosswalk", planning_horizon=10, others_gamma=(0.2, 0.7))
    monkeypatch.setitem(SETTINGS, "short", short)
    monkeypatch.setattr(value, "Clairvoyant", lambda: Clairvoyant(candidates=2))


def test_a_study_runs_and_is_resumed(small, tmp_path):
    egos = ("oracle", BASELINE)
    rows = study(tmp_path, ("short",), egos, range(1), workers=0)
    assert [r["error"] for r in rows] == [""] * 3
    costs = {r["ego"]: (r["ended"] == COLLISION, r["cost"]) for r in rows}
    assert costs[CLAIRVOYANT] <= min(costs[ego] for ego in egos)
    again = study(tmp_path, ("short",), egos, range(1), workers=0)
    assert again == rows
    alone = study(tmp_path, ("short",), egos, range(1), workers=0, clairvoyant=False)
    assert {r["ego"] for r in alone} == set(egos)
