"""The report: everything that a folder holds, on one page that needs no network."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.table import Table

from agents import make_ego
from evaluation.execution.latest_rows import present
from evaluation.execution.provenance import fingerprint
from evaluation.execution.store import Results, Store, StoreError
from evaluation.reports.comparison import write_comparison
from evaluation.reports.notes import Notes
from evaluation.reports.page import write_report
from evaluation.reports.published import compared
from evaluation.reports.replay import replay
from evaluation.rollout.endings import COLLISION, REACHED
from evaluation.rollout.setting import EGO_GAMMA, RunSetting
from evaluation.samples.recording import write_sample
from evaluation.studies import closed_loop, estimation, prediction
from evaluation.studies.closed_loop import ClosedLoop
from tests.support.made_rows import episode_rows, estimation_rows

STEPS = ("state", "seen", "planned", "predicted", "gammas", "failed")


class Tags(HTMLParser):
    """Tags that are open, all ids, links and sources."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links = [], [], []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found[name] for name in ("href", "src") if name in found]
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def page_of(path):
    """The text of a page that is well formed and loads nothing from elsewhere."""
    text = path.read_text()
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    for link in tags.links:
        assert link.startswith("data:image/png;base64,") or link.removeprefix("#") in tags.ids
    assert "@import" not in text
    assert not re.search(r"\b(fetch|XMLHttpRequest|import)\(", text)
    return text


def stored(folder, study, configuration, rows, key):
    Store(folder, study, configuration, key).append(rows)


@pytest.fixture
def results(tmp_path):
    """Three studies, one of them unknown to this version."""
    told = dict(ClosedLoop().__dict__)
    rows = [{**row, "settings": "s"} for row in episode_rows()]
    stored(tmp_path / "a" / "loop", "closed loop", told, rows, closed_loop.KEY)
    rows = [{**row, "seconds": 0.1} for row in estimation_rows()]
    stored(tmp_path / "b" / "rows", "estimation", {}, rows, estimation.KEY)
    rows = [{"seed": 1, "x": 2.0, "error": ""}, {"seed": 2, "x": None, "error": "<it> failed"}]
    stored(tmp_path / "c", "made up", {"size": 3}, rows, ("seed",))
    return tmp_path


def test_every_study_is_told(results):
    path = write_report(results, episodes=0)
    assert path == results / "report.html"
    text = page_of(path)
    for told in ("infer-gamma", "first error", "0.608", "size 3", "2 rows with error, seed, x."):
        assert told in text
    assert "&lt;it&gt; failed" in text
    assert "<it>" not in text
    names = sorted(p.name for p in (results / "figures").iterdir())
    assert names == [
        f"{stem}.{kind}"
        for stem in ("a_loop_closed_loop", "b_rows_error_against_noise")
        for kind in ("pdf", "png")
    ]
    for name in names:
        figure = results / "figures" / name
        if name.endswith("png"):
            with Image.open(figure) as picture:
                assert picture.width > 300
        else:
            box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", figure.read_bytes())
            assert float(box[1]) == pytest.approx(7.16 * 72.0, abs=0.1)


def test_the_paper_s_numbers_stand_beside_the_rows_own(results, tmp_path):
    page = tmp_path / "page.md"
    write_comparison(results, page)
    lines = page.read_text().splitlines()
    rows = estimation_rows()
    expected = [
        np.mean([r["error_squared"] for r in rows if (r["observation"], r["method"]) == key])
        for key in (("full", "assume-gamma-1"), ("full", "infer-gamma"))
    ]
    for name, reference, value in zip(
        ("assume-gamma-1", "infer-gamma"), ("0.608", "0.176"), expected, strict=True
    ):
        assert f"| mean error from full states, {name} | {reference} | - | {value:.3g} |" in lines
    with pytest.raises(ValueError, match="no study that the paper has numbers of"):
        write_comparison(results / "c", page)


def intersection_rows():
    """Errors of 2 and 1 with full states, of 4 and 3 with positions, with and without noise."""
    return [
        {"observation": o, "std": std, "method": m, "error": "", "error_squared": value}
        for o, base in (("full", 1.0), ("positions", 3.0))
        for m, value in (("infer-gamma", base), ("assume-gamma-1", base + 1.0))
        for std in (0.0, 0.1)
    ]


def driving_rows():
    return [
        {
            "scene": "left_turn", "others": others, "ego": "infer-gamma", "error": "",
            "ended": REACHED if seed else COLLISION, "min_distance": 6.5 + seed,
        }
        for others in ("receding", "idm")
        for seed in range(3)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("study", "rows", "expected"),
    [
        ("intersection", intersection_rows(), {"error saved by inferring gamma": "38 %"}),
        (
            "driving",
            driving_rows(),
            {
                "left turn, infer-gamma: nearest to another car's middle": "6.50 m / 6.50 m",
                "left turn, infer-gamma: goal reached": "2 of 3 / 2 of 3",
                "left turn, infer-gamma: collisions": "1 of 3 / 1 of 3",
            },
        ),
    ],
)
def test_numbers_that_the_paper_states(study, rows, expected):
    told = {what: here for what, *_, here in compared(Results(Path(), study, {}, "", "", "", rows))}
    assert expected.items() <= told.items()
    nothing = compared(Results(Path(), study, {}, "", "", "", []))
    assert {here for *_, here in nothing} == {""}


def test_episodes_are_played_again(tmp_path):
    """The replay is the row's episode, and what the page holds of it is JSON."""
    rows = closed_loop.study(tmp_path / "loop", ("infer-gamma",), range(1), workers=0)
    text = page_of(write_report(tmp_path, episodes=1))
    (data,) = json.loads(re.search(r"const replays = (.*);\n", text)[1])
    assert len(data["steps"]) == len(rows[0]["latencies"])
    assert all(set(step) == set(STEPS) for step in data["steps"])
    assert len(data["final"]) == len(data["names"]) == 2
    assert data["steps"][-1]["gammas"]["1"][1] > 0.0
    assert "Chosen as the first seed. Goal reached after" in text


def test_what_is_hidden_is_null():
    setting = RunSetting("crosswalk", observation="positions", noise_std=0.0)
    found = replay("constant-velocity", 0, setting, "Crosswalk")
    assert not found.data["infers"]
    first = found.data["steps"][0]
    assert first["gammas"] == {}
    assert [place[:2] for place in first["state"]] == first["seen"]  # noise-free


def test_who_plays_no_game_has_no_discount_factor():
    setting = RunSetting("driving", "lane_change", 2, behaviour="idm")
    found = replay("idm", 0, setting, "Lane change")
    assert found.data["gamma"] == [EGO_GAMMA, None]
    info = {"gamma": [0.9, 0.5]}
    np.testing.assert_array_equal(setting.true_gammas(info), [0.9, np.nan])
    game = replace(setting, behaviour="receding")
    np.testing.assert_array_equal(game.true_gammas(info), [0.9, 0.5])


def test_predictions_are_told_without_the_recordings(tmp_path):
    data = write_sample(tmp_path / "recorded").parent
    study = tmp_path / "results"
    prediction.study(study, data, ("constant-velocity",), workers=0)
    for file in data.iterdir():
        file.unlink()
    assert "DUT, test: predictions" in page_of(write_report(study, episodes=0))
    (study / "windows.parquet").unlink()
    with pytest.raises(StoreError, match=r"windows.parquet: lacks a window"):
        write_report(study, episodes=0)


def test_folders_without_results(tmp_path):
    with pytest.raises(ValueError, match=r"nothing: holds no results"):
        write_report(tmp_path / "nothing")
    Store(tmp_path, "closed loop", {}, ("seed",))
    with pytest.raises(ValueError, match="no trial has finished yet"):
        write_report(tmp_path)
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(StoreError, match="is no manifest of results"):
        write_report(tmp_path)


def test_notes_keep_tables_as_text():
    notes = Notes()
    table = Table(title="a [b]bold[/b] one")
    table.add_column("x")
    table.add_column(r"y \[m]", justify="right")
    table.add_row("1", "[red]2[/red]")
    notes.print(table)
    notes.print("[red]failed[/red]")
    notes.print("plain [1]", markup=False)
    shown, *told = notes.kept
    assert (shown.title, shown.header, shown.rows) == ("a bold one", ("x", "y [m]"), (("1", "2"),))
    assert shown.right == (False, True)
    assert told == ["failed", "plain [1]"]


def test_pictures_beside_the_rows_are_told(results):
    for name in ("heatmap", "representative_trial"):
        for kind in ("png", "pdf"):
            Image.new("RGB", (400, 300)).save(results / "b" / f"{name}.{kind}")
    text = page_of(write_report(results, episodes=0))
    assert text.count("<img") == 4
    assert (results / "figures" / "b_rows_heatmap.pdf").exists()


def loop_rows(settings, ego="infer-gamma", **more):
    return [{**row, "ego": ego, "settings": settings, **more} for row in episode_rows()[:2]]


def loop_results(rows):
    told = dict(ClosedLoop().__dict__)
    return Results(Path(), "closed loop", told, "", "", "", rows)


def test_one_setting_of_an_agent_is_told():
    """The present one; where no row has it, or it is unknown, the last that was stored."""
    now = fingerprint(make_ego("infer-gamma"))
    told, left_out = present(loop_results([*loop_rows(now), *loop_rows("old")]))
    assert ({r["settings"] for r in told.rows}, left_out) == ({now}, 2)
    for name in ("infer-gamma", "nobody_s:Ego"):
        rows = [*loop_rows("old", name), *loop_rows("later", name), *loop_rows("s", "oracle")]
        told, left_out = present(loop_results(rows))
        assert [r["settings"] for r in told.rows] == ["later", "later", "s", "s"]
        assert left_out == 2
    rows = intersection_rows()
    assert present(Results(Path(), "intersection", {}, "", "", "", rows)) == (
        Results(Path(), "intersection", {}, "", "", "", rows), 0
    )  # fmt: skip


def test_an_ego_that_is_not_here_has_no_replay(tmp_path):
    rows = loop_rows("s", "nobody_s:Ego", collision=True)
    told = dict(ClosedLoop().__dict__)
    stored(tmp_path, "closed loop", told, rows, closed_loop.KEY)
    text = page_of(write_report(tmp_path, episodes=1))
    assert "No replay of nobody_s:Ego" in text


def test_a_study_whose_trials_all_failed_is_told(results):
    rows = [{"seed": k, "x": None, "error": "no luck"} for k in range(3)]
    stored(results / "d", "unlucky", {}, rows, ("seed",))
    text = page_of(write_report(results, episodes=0))
    assert "Unlucky" in text
    assert "no luck" in text
