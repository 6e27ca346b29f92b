"""The study on a recorded window: loading, baselines, rows, pictures, command."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from typer.testing import CliRunner

from evaluation.cli import app as command_line
from evaluation.reports.intersection import (
    error_over_noise,
    print_compared_gammas,
    print_comparison,
    print_errors,
    print_gammas,
    print_violations,
    snapshot,
)
from evaluation.reports.page import write_report
from evaluation.samples.junction import FRAMES, TRACKS, write_junction_sample
from evaluation.studies import intersection as intersection_study
from evaluation.studies.intersection import (
    METHODS,
    least_observed,
    observe,
    observed_steps,
    straight,
    study,
)
from evaluation.studies.junction_comparison import compare
from evaluation.windows.intersection import (
    Case,
    Choice,
    WindowError,
    contradictions,
    difference,
    fitted_game,
    load,
)
from foresight_env.scenarios.junction import LANES


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return str(write_junction_sample(tmp_path_factory.mktemp("ind")))


def case_of(states, kinds=("pedestrian", "car")):
    present = ~np.isnan(states[..., 0])
    return Case("made", ("a", "b"), kinds, 0.5, states, present, False, 2.7)


def moving(steps=8):
    """A pedestrian and a car, straight and even."""
    times = 0.5 * np.arange(steps)[:, None]
    walker = np.concatenate([[1.0, 2.0] + times * [0.5, -1.0], np.tile([0.5, -1.0], (steps, 1))], 1)
    car = np.concatenate(
        [[0.0, 0.0] + times * [0.0, 4.0], np.tile([4.0, np.pi / 2], (steps, 1))], 1
    )
    return np.stack([walker, car], axis=1)


def test_the_published_window_is_loaded_as_published(folder):
    case = load(Choice(folder, TRACKS, FRAMES, 6, "07"))
    assert (case.agents, case.kinds) == (TRACKS, ("pedestrian", "pedestrian", "car", "car"))
    assert case.states.shape == (28, 4, 4)
    assert case.present.all()
    assert case.dt == pytest.approx(0.24)
    assert case.at_aachen
    # The car that turns begins in the northern arm, and its heading has no jump of a full turn.
    assert np.hypot(*(case.states[0, 2, :2] - [-13.3, 76.9])) < 3.0
    assert np.abs(np.diff(case.states[:, 2:, 3], axis=0)).max() < 2.0
    lanes = [p.costs[-1].lane for p in fitted_game(case, 28, 27).players[2:]]
    assert lanes == list(LANES[:2])
    # Before it turns, no method can predict the turn.
    assert fitted_game(case, 10, 27).players[2].costs[-1].lane in LANES[:2]


@pytest.mark.parametrize(
    ("told", "changes"),
    [
        ("--tracks", {"tracks": ("201", "999")}),
        ("--tracks", {"tracks": ("201", "201")}),
        ("--frames", {"frames": (26158, 26176)}),
        ("--frames", {"frames": (26400, 26600)}),
        ("--every", {"every": 0}),
    ],
)
def test_wrong_choices_are_named(folder, told, changes):
    arguments = {"data": folder, "tracks": TRACKS, "frames": FRAMES, "recording": "07"}
    with pytest.raises(WindowError, match=told):
        load(Choice(**{**arguments, **changes}))


def test_places_can_be_chosen(folder):
    assert not load(Choice(folder, TRACKS, FRAMES, place="open")).at_aachen
    whole = load(Choice(folder, TRACKS, place="aachen"))  # all frames that they share
    assert len(whole.states) == 29


def test_differences_take_the_short_way_round_and_leave_out_who_is_missing():
    states = moving()
    states[3, 0] = np.nan
    case = case_of(states)
    other = moving() + 0.1
    other[:, 1, 3] += 2.0 * np.pi
    gap = difference(case, other)
    assert np.allclose(gap[case.present], 0.1)
    assert np.array_equal(gap[3, 0], np.zeros(4))


def test_constant_velocity_is_exact_where_it_holds():
    states = moving()
    states[2, 0] = states[5:, 1] = np.nan
    case = case_of(states)
    for observation in ("full", "positions"):
        seen = observe(case, observation, 0.0, 0, 6)
        assert np.isnan(seen[6:]).all()
        np.testing.assert_allclose(straight(case, seen), moving(), atol=1e-12)
        np.testing.assert_allclose(straight(case, seen, 3), moving(), atol=1e-12)


def test_predictions_begin_when_all_agents_have_been_observed():
    states = moving()
    states[:5, 1] = np.nan
    case = case_of(states)
    assert least_observed(case) == 6
    with pytest.raises(ValueError, match="--at: is 4; expected 6 to 7 observed steps"):
        compare(case, 4)


def test_the_default_moment_fits_the_window():
    assert [observed_steps(None, steps) for steps in (4, 8, 16, 28, 100)] == [3, 5, 9, 15, 15]
    assert observed_steps(None, 8, least=7) == 7
    assert observed_steps(7, 8) == 7
    for at in (2, 8, 15):
        with pytest.raises(ValueError, match=f"--at: is {at}; expected 3 to 7 observed steps"):
            observed_steps(at, 8)
    for steps, least in ((3, 3), (8, 8)):
        with pytest.raises(ValueError, match="--frames: the window has"):
            observed_steps(None, steps, least)


def test_the_same_sequence_goes_to_everybody():
    case = case_of(moving())
    first = observe(case, "full", 0.1, 3, 8)
    assert np.array_equal(first, observe(case, "full", 0.1, 3, 8))
    assert not np.array_equal(first, observe(case, "full", 0.1, 4, 8))
    assert np.std(first - case.states.reshape(8, -1)) == pytest.approx(0.1, rel=0.3)


def test_a_small_study(folder, tmp_path, monkeypatch):
    choice = Choice(folder, ("201", "205"), (26158, 26200), 6, "07")
    settings = {"observations": ("full",), "workers": 0}
    rows = study(tmp_path / "rows", choice, 1, 3, **settings)
    assert [r["method"] for r in rows] == sorted(METHODS)  # one noise-free sequence of each
    assert all(r["solved"] and not r["error"] for r in rows)
    errors = {r["method"]: r["error_squared"] for r in rows}
    assert errors["infer-gamma"] < errors["assume-gamma-1"]
    assert errors["infer-gamma"] < errors["constant-velocity"]
    inferred = next(r for r in rows if r["method"] == "infer-gamma")
    assert len(inferred["gamma"]) == 2
    assert all(
        low <= g <= high
        for g, low, high in zip(
            inferred["gamma"], inferred["gamma_low"], inferred["gamma_high"], strict=True
        )
    )
    monkeypatch.setattr(intersection_study, "fit", None)  # nothing is run again
    assert study(tmp_path / "rows", choice, 1, 3, **settings) == rows
    with pytest.raises(ValueError, match="another configuration"):
        study(tmp_path / "rows", choice, 1, 3, parameters="all", **settings)
    monkeypatch.undo()
    case = load(choice)
    predictions = compare(case, 5)
    assert [(p.game, p.method) for p in predictions] == [
        ("published", "infer-gamma"),
        ("published", "assume-gamma-1"),
        ("realistic", "infer-gamma"),
        ("realistic", "assume-gamma-1"),
        ("", "constant-velocity"),
    ]
    assert all(p.fit_solved and p.prediction_solved for p in predictions)
    assert [p.gamma is not None for p in predictions] == [True, False, True, False, False]
    fits = {p.game: p.fit_squared for p in predictions if p.method == "infer-gamma"}
    assert fits["published"] == pytest.approx(errors["infer-gamma"])
    assert fits["realistic"] < predictions[-1].fit_squared
    for p in predictions:
        gap = np.linalg.norm(p.states[5:, :, :2] - case.states[5:, :, :2], axis=2)
        assert p.average_error == pytest.approx(gap.mean())
    console = Console(record=True, width=100)
    print_errors(console, rows)
    print_gammas(console, rows)
    print_comparison(console, case, 5, predictions)
    print_compared_gammas(console, case, predictions)
    told = console.export_text()
    for word in ("infer-gamma", "constant-velocity", "pedestrian", "from 5 steps", "realistic"):
        assert word in told
    for path in (
        error_over_noise(rows, tmp_path / "errors.png"),
        snapshot(case, 5, predictions, tmp_path / "snapshot.png"),
    ):
        with Image.open(path) as image:
            assert image.width > 600
    snapshot(case, 5, predictions, tmp_path / "snapshot.pdf")
    page = write_report(tmp_path).read_text()
    for word in ("Inferred discount factors", "205", "dots observed", "error saved by inferring"):
        assert word in page
    assert (tmp_path / "figures" / "rows_snapshot.pdf").stat().st_size > 1000
    with pytest.raises(ValueError, match="--at"):
        compare(case, 8)


def test_parts_of_the_region_that_a_car_was_seen_in_bind_no_car(folder):
    """The made window lies on the road; moved off it, its cars drop what one contradicts."""
    case = load(Choice(folder, TRACKS, FRAMES, 6, "07"))
    assert not any(contradictions(case, len(case.states)).values())
    moved = np.array(case.states)
    moved[:, 3, 0] += 6.0  # the car that goes straight on, over the eastern side of its road
    beside = case._replace(states=moved)
    found = contradictions(beside, len(case.states))
    assert [bool(found[agent]) for agent in TRACKS] == [False, False, False, True]

    def rows(of):
        return [sum(c.size for c in p.inequalities) for p in fitted_game(of, 28, 27).players]

    less = len(found[TRACKS[3]])
    assert np.subtract(rows(case), rows(beside)).tolist() == [0, 0, less, less]
    console = Console(record=True, width=100)
    print_violations(console, found)
    assert f"{TRACKS[3]}: recorded" in console.export_text()


def test_the_command_chooses_a_moment_that_fits(folder, tmp_path, monkeypatch):
    """A window of 8 steps, of which 15 cannot be observed."""
    monkeypatch.setattr("foresight_env.compilation.enable_compilation_cache", lambda: None)
    monkeypatch.setattr(intersection_study, "study", lambda *arguments, **more: [])
    chosen = []

    def predicted(case, known, parameters):
        chosen.append((len(case.states), known))
        raise ValueError("enough")

    monkeypatch.setattr("evaluation.cli.demonstration.compare", predicted)
    command = ["evaluate", "intersection", "--data", folder, "--tracks", "201,205"]
    command += ["--frames", "26158:26200", "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(command_line.app, command).stderr == "foresight: enough\n"
    assert chosen == [(8, 5)]
    result = CliRunner().invoke(command_line.app, [*command, "--at", "15"])
    assert "--at: is 15; expected 3 to 7 observed steps" in result.stderr


@pytest.mark.parametrize(
    ("told", "arguments"),
    [
        ("--tracks", ("--data", "FOLDER")),
        ("--data", ("--tracks", "201,207")),
        ("--frames", ("--data", "FOLDER", "--tracks", "201,207", "--frames", "1-2")),
        ("--tracks", ("--data", "FOLDER", "--tracks", "201,9")),
        ("--at", ("--data", "FOLDER", "--tracks", "201,207", "--at", "100")),
        ("--at", ("--at", "100")),
        ("there is no such file", ("--data", "NOWHERE", "--tracks", "201")),
    ],
)
def test_the_command_names_what_is_wrong_and_writes_nothing(
    folder, tmp_path, monkeypatch, told, arguments
):
    monkeypatch.setattr("foresight_env.compilation.enable_compilation_cache", lambda: None)
    monkeypatch.setenv("COLUMNS", "200")
    out = tmp_path / "out"
    given = [{"FOLDER": folder, "NOWHERE": str(tmp_path / "no.csv")}.get(a, a) for a in arguments]
    command = ["evaluate", "intersection", *given, "--out", str(out)]
    result = CliRunner().invoke(command_line.app, command)
    assert result.exit_code == 2, result.output
    assert told in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not out.exists()
