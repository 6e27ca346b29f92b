"""Predictions on recordings: which windows count, what is kept, what is reported."""

import io

import numpy as np
import pytest
from rich.console import Console

from evaluation.reports import prediction as prediction_report
from evaluation.studies import prediction
from evaluation.studies.prediction import study
from evaluation.windows.interaction import (
    DEVELOPMENT,
    LEAST_OBSERVED,
    LEAST_PREDICTED,
    NEAR,
    PREDICTED_SECONDS,
    Grid,
    connected,
    cut,
    interaction_windows,
    split_of,
)
from evaluation.windows.nearby import nearby_windows
from foresight_env.datasets import Recording, Track, write_ucy
from tests.support.made_crossings import FRAMES, RATE, recording, two_people, walk


def test_windows_follow_the_rule():
    windows = interaction_windows(two_people())
    assert windows
    crossing = 8.0, 8.8
    for window in windows:
        now = window.frame / RATE
        assert window.agents == ("1", "2")
        # The first to cross does so within the window, the second after the moment.
        assert crossing[0] < now + PREDICTED_SECONDS
        assert crossing[1] > now
        apart = np.linalg.norm(window.truth[:, 0] - window.truth[:, 1], axis=1)
        assert np.nanmin(apart) < NEAR
        assert window.seen_steps >= LEAST_OBSERVED
        assert window.present[:LEAST_PREDICTED].all()
    # And no moment is left out: from the first that sees 8.0 s up to the last before 8.8 s.
    assert [w.frame for w in windows] == list(range(110, 220, 10))


def test_a_window_is_what_was_recorded():
    made = two_people()
    grid = Grid.of(made)
    window = cut(made, ("2", "1"), 120)
    assert (grid.dt, grid.observed, grid.predicted) == (0.4, 9, 10)
    assert window.history.states.shape == (9, 2, 4)
    assert window.truth.shape == (10, 2, 2)
    track = made.track("2")
    np.testing.assert_array_equal(window.history.states[-1, 0, :2], track.position[12])
    np.testing.assert_array_equal(window.truth[0, 0], track.position[13])
    late = cut(made, ("2", "1"), 50)
    assert np.isnan(late.history.states[:3]).all()
    assert late.seen_steps == 6


@pytest.mark.parametrize(
    "other",
    [
        walk("2", (0.0, -18.0), (0.0, 1.25), FRAMES),  # crosses 6 s later, never within 5 m
        walk("2", (-10.0, 0.5), (1.25, 0.0), FRAMES),  # passes next to the other
        walk("2", (0.0, -11.0), (0.0, 1.25), range(170, 400, 10)),  # is there too late to be seen
        walk("2", (0.0, -11.0), (0.0, 1.25), range(0, 130, 10)),  # has left by then
    ],
)
def test_who_does_not_interact(other):
    alone = walk("1", (-10.0, 0.0), (1.25, 0.0), FRAMES)
    near = [w for w in interaction_windows(recording(alone, other)) if w.frame < 200]
    assert not near


def test_groups_stay_small():
    """Five people meet at the origin at once; they are divided, no agent is in two groups."""
    angles = 2.0 * np.pi * np.arange(5) / 5
    made = recording(
        *(
            walk(str(k), (-10 * np.cos(a), -10 * np.sin(a)), (np.cos(a), np.sin(a)), FRAMES)
            for k, a in enumerate(angles)
        )
    )
    windows = interaction_windows(made)
    assert windows
    for frame in {w.frame for w in windows}:
        members = [agent for w in windows if w.frame == frame for agent in w.agents]
        assert len(members) == len(set(members))
    assert max(len(w.agents) for w in windows) == 4
    assert len(set(connected(windows))) == 1


def test_all_windows_hold_everybody_who_moves():
    """Once each at every moment, near ones together; those who stand are left out."""
    made = recording(
        walk("1", (-10.0, 0.0), (1.25, 0.0), FRAMES),
        walk("2", (-10.0, 2.0), (1.25, 0.0), FRAMES),
        walk("3", (500.0, 0.0), (1.25, 0.0), FRAMES),
        walk("4", (-8.0, 0.0), (0.0, 0.0), FRAMES),
    )
    windows = nearby_windows(made)
    moments = {w.frame for w in windows}
    assert len(moments) > 5
    for frame in moments:
        assert sorted(w.agents for w in windows if w.frame == frame) == [("1", "2"), ("3",)]
    assert nearby_windows(recording()) == ()


def test_histories_know_the_routes_of_earlier_traffic():
    """A car that has left shows the way; one that is still there does not."""
    rate, seen = 10.0, np.arange(60)
    places = np.stack([0.5 * seen, 0.0 * seen], axis=1)
    velocity = np.tile([5.0, 0.0], (60, 1))
    cars = tuple(
        Track(name, "car", first + seen, places, velocity, 0.0 * seen)
        for name, first in (("a", 0), ("b", 70))
    )
    made = Recording("made", "dut", rate, cars)
    assert cut(made, ["a"], 40).history.context.routes == ()
    context = cut(made, ["b"], 110).history.context
    assert context.frequencies.tolist() == [1.0]
    np.testing.assert_allclose(context.routes[0][:, 1], 0.0, atol=1e-9)


def test_splits_share_no_recording():
    assert split_of(DEVELOPMENT[0]) == "development"
    assert split_of("intersection_15") == split_of("zara02") == "test"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    write_ucy(two_people(), folder / "crossing_obsmat.txt")
    return folder


SIMPLE = ("constant-velocity", "constant-turn-rate")


def test_every_window_has_a_row_for_everybody(tmp_path, data, monkeypatch):
    rows = study(tmp_path, data, SIMPLE, workers=0)
    windows = interaction_windows(two_people())
    assert len(rows) == len(SIMPLE) * len(windows)
    assert {r["predictor"] for r in rows} == set(SIMPLE)
    assert all(r["error"] == "" and r["split"] == "test" for r in rows)
    # They walk evenly, so straight on is right.
    assert max(r["average_error"] for r in rows) < 1e-6

    def not_again(*arguments, **more):
        raise AssertionError("a window that has a row was run again")

    # Another predictor is added; what there is stays.
    monkeypatch.setattr(prediction, "run_window", not_again)
    assert study(tmp_path, data, SIMPLE, workers=0) == rows
    monkeypatch.undo()
    assert len(study(tmp_path, data, SIMPLE[:1], workers=0)) == len(windows)


def test_bad_requests(tmp_path, data):
    with pytest.raises(ValueError, match="split: is 'some'; expected development, test or all"):
        study(tmp_path / "a", data, SIMPLE, split="some")
    with pytest.raises(
        ValueError, match=r"no window in .* \(windows interacting, split development: none\)"
    ):
        study(tmp_path / "b", data, SIMPLE, split="development")
    with pytest.raises(ValueError, match="windows: is 'some'; expected interacting or all"):
        study(tmp_path / "d", data, SIMPLE, windows="some")
    with pytest.raises(ValueError, match="predictor: 'magic' is unknown"):
        study(tmp_path / "c", data, ("magic",))
    assert not list(tmp_path.iterdir())


def test_the_report_counts_failures_and_compares_the_rest(tmp_path, data):
    rows = study(tmp_path / "study", data, SIMPLE, workers=0)
    errors = [1.0 + (r["predictor"] == SIMPLE[1]) for r in rows]
    names = ("average_error", "best_average_error")
    rows = [{**r, **dict.fromkeys(names, e)} for r, e in zip(rows, errors, strict=True)]
    rows[0] = {**rows[0], "error": "ValueError: no luck"}
    console = Console(file=io.StringIO(), width=100)
    prediction_report.print_prediction(console, rows)
    text = console.file.getvalue()
    assert "1 prediction failed; first: constant-turn-rate: ValueError: no luck" in text
    (turn, velocity) = prediction_report.summary(rows)
    # The window that failed for one is left out for both.
    assert turn["windows"] == velocity["windows"] == len(rows) // 2 - 1
    assert (turn["ADE [m]"], velocity["ADE [m]"]) == ("2.000", "1.000")
    assert prediction_report.likelihoods(rows) == []
    told = [{**r, "nll": 1.5} for r in rows]
    assert {line["NLL"] for line in prediction_report.likelihoods(told)} == {"1.50"}
    (line,) = prediction_report.differences(rows)
    assert line["ADE [m]"] == "+1.000 (too few groups)"
    assert line["won"] == "0%"
    picture = prediction_report.error_over_time(rows, tmp_path / "picture.png")
    assert picture.stat().st_size > 10_000


def test_errors_by_class_in_mixed_windows(tmp_path, data):
    """One person who is off by 1 m and one vehicle by 3 m; the other predictor's vehicle by 5 m."""
    rows = study(tmp_path / "study", data, SIMPLE, workers=0)
    mixed = []
    for row in rows:
        vehicle = 3.0 if row["predictor"] == SIMPLE[0] else 5.0
        each = {name: [1.0, vehicle] for name in row if name.startswith("agent_")}
        each |= {"agent_lateral_predicted": [0.5, vehicle], "kinds": ["pedestrian", "car"]}
        mixed.append({**row, **each})
    lines = prediction_report.by_class(mixed)
    found = {(line["class"], line["predictor"]): line for line in lines}
    assert found["people", SIMPLE[0]]["ADE [m]"] == "1.000"
    assert found["vehicles", SIMPLE[0]]["ADE [m]"] == "3.000"
    assert found["vehicles", SIMPLE[1]]["2 s: ADE / FDE [m]"] == "5.00 / 5.00"
    column = "lateral acceleration, p99 (recorded) [m/s^2]"
    assert found["vehicles", SIMPLE[1]][column] == "5.0 (5.0)"
    gaps = {line["class"]: line for line in prediction_report.class_differences(mixed)}
    first = prediction_report.predictors(mixed)[0]
    sign = "-" if first == SIMPLE[0] else "+"
    assert gaps["vehicles"]["ADE [m]"] == f"{sign}2.000 (too few groups)"
    assert gaps["people"]["ADE [m]"] == "+0.000 (too few groups)"
    own = prediction_report.by_recording(mixed)
    assert {(line["recording"], line["class"]) for line in own} == {
        ("crossing", "people"), ("crossing", "vehicles"),
    }  # fmt: skip
    column = f"minus {prediction_report.REFERENCES[0]}, by window"
    found = {(line["class"], line["predictor"]): line for line in own}
    assert found["vehicles", SIMPLE[1]]["ADE [m]"] == "5.000"
    assert found["vehicles", SIMPLE[1]][column] == "+2.000 (too few groups)"
    assert found["vehicles", SIMPLE[0]][column] == ""


def test_each_predictor_is_compared_with_both_references(tmp_path, data):
    """Differences of the references are shown once; others are compared with each."""
    rows = study(tmp_path / "study", data, SIMPLE, workers=0)
    others = {SIMPLE[0]: 1.0, "constant-acceleration": 2.0, "kalman": 4.0}
    made = [
        {**row, "predictor": name, "agent_errors": [error, error + 1.0]}
        for name, error in others.items()
        for row in rows
        if row["predictor"] == SIMPLE[0]
    ]
    lines = prediction_report.class_differences(made)
    found = {(line["predictor"], line["minus"]): line["ADE [m]"] for line in lines}
    assert found == {
        ("constant-acceleration", "constant-velocity"): "+1.000 (too few groups)",
        ("kalman", "constant-velocity"): "+3.000 (too few groups)",
        ("kalman", "constant-acceleration"): "+2.000 (too few groups)",
    }
    assert {line["class"] for line in lines} == {"people"}


def test_calibration_and_collisions_in_the_report(tmp_path, data):
    rows = study(tmp_path / "study", data, ("constant-velocity", "kalman"), workers=0)
    rows = [{**row, "overlaps": 3, "overlaps_recorded": 2} for row in rows]
    kalman, velocity = sorted(
        prediction_report.likelihoods(rows), key=lambda line: line["predictor"] != "kalman"
    )
    # Kalman's regions are far too wide for people who walk evenly.
    assert (kalman["50% region"], kalman["90% region"]) == ("100%", "100%")
    assert velocity["50% region"] == velocity["90% region"] == "-"
    assert {line["ratio"] for line in prediction_report.summary(rows)} == {"1.50"}
    ((title, curves),) = prediction_report.curves(rows).items()
    assert title == "UCY, test"
    assert curves.keys() == {"kalman"}
    picture = prediction_report.draw_reliability(rows, tmp_path / "picture.png")
    assert picture.stat().st_size > 10_000


def test_a_study_of_all_windows(tmp_path, data):
    rows = study(tmp_path, data, SIMPLE[:1], windows="all", workers=0)
    expected = nearby_windows(two_people())
    assert sorted((r["frame"], r["agents"]) for r in rows) == sorted(
        (w.frame, ",".join(w.agents)) for w in expected
    )
    with pytest.raises(ValueError, match="another configuration"):
        study(tmp_path, data, SIMPLE[:1], workers=0)
