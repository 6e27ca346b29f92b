"""The benchmark: fair cases, the best on top, numbers that a paper can cite, one-line errors."""

import csv
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from agents.interfaces.predictor import History, single
from evaluation.cli.app import app
from evaluation.cli.benchmark import PLANNED_NAMES
from evaluation.reports import benchmark as benchmark_report
from evaluation.reports.benchmark_page import print_parts, write_page
from evaluation.reports.benchmark_results import closed_part, common, open_part, write_csv
from evaluation.studies import benchmark as benchmark_study
from evaluation.studies import prediction
from evaluation.studies.benchmark import BenchmarkConfiguration
from evaluation.windows import simulated as simulated_windows


def driven(seed, time=3.0, collision=False, reached=True):
    return {
        "collision": collision, "off_road": False, "goal_reached": reached, "time": time,
        "time_limit": 10.0, "cost": 5.0 + seed, "min_gap": 1.0, "prediction_error": None,
        "seconds": [0.01, 0.02], "failed": 0,
    }  # fmt: skip


def predicted(error, agents=2):
    return {
        "average_error": error, "final_error": 2 * error, "missed": 1, "agents": agents,
        "best_average_error": error, "nll": None, "levels": None, "overlaps": 3,
        "overlaps_recorded": 2, "seconds": [0.001], "failed": 0,
    }  # fmt: skip


def test_all_methods_have_the_same_cases_and_one_without_any_is_told():
    methods = {
        "a": {k: (k, predicted(1.0)) for k in range(8)},
        "b": {k: (k, predicted(2.0)) for k in range(7)},
        "c": {},
    }
    part = open_part("somewhere", common(methods), {"b": ["no"], "c": ["no"] * 8})
    assert [(line.method, line.cases) for line in part.lines] == [("a", 7), ("b", 7), ("c", 0)]
    assert part.lines[2].values["failed trials"].mean == 8.0
    assert part.lines[0].values["missed"].mean == 50.0
    assert part.lines[0].values["ADE"].rank == (1, 1, 1)
    assert part.lines[1].values["ADE"].rank == (2, 2, 2)


def test_who_collides_is_below_and_its_time_is_the_limit():
    methods = {
        "bold": {k: (k, driven(k, 2.0, k < 6, k >= 6)) for k in range(12)},
        "slow": {k: (k, driven(k, 9.0)) for k in range(12)},
        "late": {k: (k, driven(k, 10.0, reached=False)) for k in range(12)},
    }
    part = closed_part("somewhere", common(methods), {})
    assert [line.method for line in part.lines] == ["slow", "late", "bold"]
    bold = part.lines[2].values
    assert bold["collided"].mean == 50.0
    assert bold["time to goal"].mean == pytest.approx(0.5 * 2.0 + 0.5 * 10.0)
    assert bold["cost"].mean == pytest.approx(5.0 + np.arange(6, 12).mean())
    never = part.lines[0].values["collided"]
    assert never.mean == never.low == 0.0
    assert 20.0 < never.high < 30.0  # twelve quiet episodes do not make it sure
    assert np.isnan(bold["1 s ahead"].mean)
    assert (bold["p50"].mean, bold["failed"].mean) == (pytest.approx(15.0), 0.0)


class Outline(HTMLParser):
    """Tags must match; scripts and addresses of other machines are counted."""

    def __init__(self):
        super().__init__()
        self.open, self.foreign, self.text = [], 0, []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "br", "line", "circle"):
            self.open.append(tag)
        self.foreign += tag in ("script", "link", "img", "iframe")

    def handle_endtag(self, tag):
        if tag not in ("line", "circle"):
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_failed_trials_are_counted_with_the_first_error():
    methods = {"a": {0: (0, predicted(1.0))}, "b": {}}
    part = open_part("somewhere", common(methods), {"b": ["[no] luck", "other"]})
    console = Console(file=io.StringIO(), width=100)
    print_parts(console, [part])
    assert "b: 2 trials failed; first: [no] luck" in console.file.getvalue()


def recorded(predictor, frame, error=""):
    """A window of a pedestrian and a car; the car's error is 1 m more."""
    row = predicted(0.5 if predictor == "good" else 1.5) | {
        "source": "dut", "split": "test", "recording": "clip", "content": "", "frame": frame,
        "agents": "a,b", "group": f"clip {frame}", "predictor": predictor, "error": error,
        "fallback": False, "kinds": ["pedestrian", "car"], "seconds": 0.001,
    }  # fmt: skip
    base = row["average_error"] - 0.5
    return row | {"agent_errors": [base, base + 1.0]}


def test_people_and_vehicles_of_recordings_apart():
    rows = [recorded(name, frame) for name in ("good", "poor") for frame in range(8)]
    parts = benchmark_report.recorded_parts(rows, ("good", "poor"))
    assert [p.place for p in parts] == ["DUT, test", "DUT, test, people", "DUT, test, vehicles"]
    means = [[line.values["ADE"].mean for line in part.lines] for part in parts]
    assert means == [[0.5, 1.5], [0.0, 1.0], [1.0, 2.0]]
    broken = [recorded("poor", frame, "no luck") for frame in range(8)]
    (part,) = benchmark_report.recorded_parts(broken, ("poor",))
    assert part.lines[0].values["failed trials"].mean == 8.0


def test_page_and_table(tmp_path):
    methods = {
        "kalman": {k: (k, predicted(0.5 + 0.01 * k)) for k in range(8)},
        "mine:<Net>": {k: (k, predicted(0.25)) for k in range(8)},
    }
    egos = {"mine:<Net>+plan": {k: (k, driven(k)) for k in range(3)}, "oracle": {}}
    parts = (open_part("UCY, test", common(methods), {}), closed_part("x_y", common(egos), {}))
    page = write_page(parts, tmp_path / "page.html", "split test").read_text()
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    assert outline.foreign == 0
    assert "http" not in page
    told = " ".join(" ".join(outline.text).split())
    assert told.index("mine:<Net> 1") < told.index("kalman 2")
    assert "X y: 3 episodes" in told
    with write_csv(parts, tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    (row,) = [r for r in rows if (r["method"], r["metric"]) == ("kalman", "ADE")]
    assert float(row["mean"]) == pytest.approx(0.535)
    assert float(row["low_95"]) < 0.535 < float(row["high_95"])
    assert (row["rank"], row["rank_low_95"], row["unit"], row["cases"]) == ("2", "2", "m", "8")


def test_simulated_windows_are_what_was_seen_and_what_happened():
    """Noise is small relative to motion: predictors get the right agent in the right place."""
    for place in ("crosswalk", "intersection"):
        windows = simulated_windows.simulated_windows(place, 5)
        assert windows
        for window in windows:
            history = window.history
            assert history.dt == pytest.approx(0.4, abs=0.1)
            straight = history.states[-1, :, :2] + history.dt * history.states[-1, :, 2:]
            assert np.abs(straight - window.truth[0]).max() < 1.5
            assert not np.array_equal(straight, window.truth[0])
        cars = [k == "car" for k in windows[0].history.kinds]
        assert any(cars) == (place == "intersection")
        assert np.isfinite(windows[0].history.headings[:, cars]).all()


@pytest.mark.parametrize("place", ["crosswalk", "intersection", "merge"])
def test_contexts_have_the_place_s_game_and_routes(place):
    window = simulated_windows.simulated_windows(place, 5)[0]
    context, now = window.history.context, window.history.states[-1]
    assert len(context.game.game.players) == len(window.agents)
    names = {name for name, _ in context.game.population.deviation}
    assert all(names <= set(theta) for theta in context.game.population.theta)
    for i, kind in enumerate(window.history.kinds):
        if kind == "car":
            away = [np.hypot(*(route[:, :2] - now[i, :2]).T).min() for route in context.routes]
            assert min(away) < 1.5
    for route in context.routes:
        steps = np.hypot(*np.diff(route[:, :2], axis=0).T)
        np.testing.assert_allclose(steps, 1.0, atol=0.05)


def test_predictors_that_need_a_game_are_left_out_of_recordings(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        benchmark_report.prediction, "study", lambda out, data, names, **more: asked.append(names)
    )
    monkeypatch.setattr(benchmark_report, "recorded_parts", lambda rows, names: [])
    for names in (("kalman", "scene-game"), ("scene-game",)):
        configuration = BenchmarkConfiguration((), (), names, (), 1)
        benchmark_report.benchmark(configuration, tmp_path, "test", 0, tmp_path / "out")
    assert asked == [("kalman",)]


class Straight:
    """A user's predictor, whose name is not that of its class."""

    name = "straight on"

    def predict(self, history: History, steps: int):
        times = history.dt * np.arange(1, steps + 1)[:, None, None]
        return single(history.states[-1, :, :2] + times * history.states[-1, :, 2:])


again = Straight()


@pytest.fixture
def command(monkeypatch):
    monkeypatch.setattr("foresight_env.compilation.enable_compilation_cache", lambda: None)
    monkeypatch.setenv("COLUMNS", "160")
    return lambda *given: CliRunner().invoke(app, ["benchmark", *map(str, given)])


def test_anybody_s_own_predictor_is_a_line_of_the_table(command, tmp_path, monkeypatch):
    prediction.warm_up.cache_clear()
    out = tmp_path / "out"
    given = ("--scenarios", "crosswalk", "--episodes", 2, "--workers", 0, "--out", out)
    own = f"{__name__}:Straight"
    chosen = (
        "--predictors",
        f"constant-velocity,{own}",
        "--egos",
        f"constant-velocity,{own}+plan",
    )
    result = command(*given, *chosen)
    assert result.exit_code == 0, result.output
    shown = "straight on"
    for text in (result.output, (out / "benchmark.html").read_text()):
        assert shown in text
        assert f"{shown}+plan" in text
        assert own not in text
    with (out / "benchmark.csv").open() as file:
        rows = list(csv.DictReader(file))
    mine, theirs = (
        [float(r["mean"]) for r in rows if r["method"] == name and r["metric"] == "ADE"]
        for name in (shown, "constant-velocity")
    )
    assert mine == pytest.approx(theirs)
    assert {r["loop"] for r in rows if r["method"].startswith(shown)} == {
        "open loop",
        "closed loop",
    }

    def not_again(*arguments, **more):
        raise AssertionError("a trial that has a row was run again")

    monkeypatch.setattr(benchmark_study, "run_episode", not_again)
    monkeypatch.setattr(benchmark_study, "run_windows", not_again)
    assert command(*given, *chosen).exit_code == 0


@pytest.mark.parametrize(
    ("told", "given"),
    [
        ("--scenarios: 'moon' is unknown; choose from", ["--scenarios", "moon"]),
        ("--predictors: 'magic' is unknown; choose from", ["--predictors", "magic"]),
        ("predictor: 'nowhere:Net': 'nowhere' cannot be", ["--predictors", "nowhere:Net"]),
        ("predictor: 'magic' is unknown", ["--egos", "magic+plan"]),
        ("--scenarios, --data: are both empty", ["--scenarios", ""]),
        ("--predictors, --egos: are both empty", ["--predictors", "", "--egos", ""]),
        ("--others: 'ghosts' is unknown", ["--others", "ghosts"]),
        (
            f"--predictors: {__name__}:Straight and {__name__}:again are both named 'straight on'",
            ["--predictors", f"kalman,{__name__}:Straight,{__name__}:again"],
        ),
    ],
)
def test_what_is_wrong_is_told_before_anything_runs(command, tmp_path, told, given):
    result = command(*given, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert told in re.sub(r"\s+", " ", result.output + result.stderr)
    assert not (tmp_path / "out").exists()


def test_names_are_those_of_the_registry():
    configuration = BenchmarkConfiguration(
        ("crosswalk", "merge"), ("receding", "idm"), (), ("oracle", "idm"), 1
    )
    assert configuration.egos_of("crosswalk") == ("oracle",)
    assert configuration.egos_of("merge") == ("oracle", "idm")
    assert configuration.pairs() == [
        ("crosswalk", "receding"),
        ("merge", "receding"),
        ("merge", "idm"),
    ]
    assert "kalman+plan" in PLANNED_NAMES
