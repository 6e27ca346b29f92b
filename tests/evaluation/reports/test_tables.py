"""Tables on the terminal: units survive, and unidentified gammas are marked."""

import io
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from rich.console import Console

from agents.interfaces.predictor import Forecast, History
from evaluation.reports import figures, naming, tables
from evaluation.reports.terminal import terminal
from evaluation.studies.closed_loop import summarise
from evaluation.windows.encounters import PREDICTORS, Encounter, Judged
from evaluation.windows.interaction import PredictionWindow
from foresight_env.datasets import Interaction
from tests.support.made_rows import episode_rows, estimation_rows


def shown(function, *arguments, width=80):
    """Output of a function on a terminal of that width."""
    console = Console(file=io.StringIO(), width=width)
    function(console, *arguments)
    return console.file.getvalue()


@lru_cache
def encounter(name="intersection_03"):
    """Two agents; the second is not observed at the end."""
    truth = np.zeros((10, 2, 4))
    truth[:, :, 0] = 0.1 * np.arange(10)[:, None]
    present = np.ones((10, 2), bool)
    present[7:, 1] = False
    agents = ("ped:0", "veh:12")
    crossing = Interaction(
        agents,
        ("pedestrian", "vehicle"),
        np.zeros(2),
        0.0,
        (1.0, 2.0),
        1.5,
        0.3,
        40,
        8.0,
        0,
        20,
        10,
    )
    history = History(
        np.zeros((9, 2, 4)),
        np.zeros((9, 2)),
        crossing.kinds,
        np.full((2, 2), np.nan),
        0.4,
    )
    places = np.where(present[..., None], truth[..., :2], np.nan)
    window = PredictionWindow(name, agents, 40, history, places)
    return Encounter(crossing, window, 2.0)


def forecasts(gamma, deviation, identifiable):
    path = np.full((1, 10, 2, 2), 0.25)
    plain = Forecast(path, np.ones(1))
    known = [np.array(values) for values in (gamma, deviation, identifiable)]
    inferred = Forecast(path, np.ones(1), None, *known)
    return [
        Judged(name, inferred if name == "encounter-game" else plain, 0.25, 0.5)
        for name in PREDICTORS
    ]


def told(*results):
    return shown(tables.print_encounters, results)


def test_output_to_a_file_is_not_cut(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    terminal().print("word " * 35)  # 174 characters
    assert capsys.readouterr().out.count("\n") == 1
    monkeypatch.setenv("COLUMNS", "60")
    terminal().print("word " * 35)
    assert capsys.readouterr().out.count("\n") == 3


def test_units_are_shown():
    rows = episode_rows()
    summaries = [summarise(rows, ego) for ego in ("infer-gamma", "assume-gamma-1")]
    text = shown(tables.print_closed_loop, summaries, rows)
    for unit in ("min distance [m]", "time to goal [s]", "decision p50 [ms]"):
        assert unit in text
    assert "count with 10 s" in text
    assert "oracle" not in text
    timed = [{**row, "seconds": 0.5} for row in estimation_rows()]
    assert "time [s]" in shown(tables.print_estimation, timed, width=100)
    assert "FDE [m]" in told((encounter(), forecasts([0.5, 0.5], [0.1, 0.1], [True, True])))


def test_inferred_gammas():
    given = forecasts([0.0, 1.5], [0.0, 0.0], [False, True])
    assert told((encounter(), given)).count("0.00 (open)") == 1
    assert "1.50 (limit)" in told((encounter(), given))
    text = told((encounter(), forecasts([0.8, 0.4], [0.1, 0.2], [True, False])))
    assert "0.80 ±0.16" in text  # 1.645 deviations
    assert "0.40 (open)" in text
    assert "±90 %" in text


def test_encounters_of_one_recording_fit_a_narrow_terminal():
    pair = encounter(), forecasts([0.8, 0.4], [0.1, 0.2], [True, True])
    text = told(pair, pair)
    assert text.count("intersection_03") == 1
    assert "…" not in text
    assert "│    10 │" in text
    assert "│     7 │" in text
    other = encounter("[05]"), pair[1]
    text = told(pair, other)
    assert "[05]" in text
    assert "recording" in text


def test_errors_far_below_the_bound_are_explained():
    rows = [{**row, "seconds": 0.5} for row in estimation_rows()]
    assert "it is local" in shown(tables.print_estimation, rows)
    full = [{**row, "error_squared": 1e3} for row in rows]
    assert "it is local" not in shown(tables.print_estimation, full)


@pytest.mark.parametrize("span", [0.5, 20.0])
def test_a_picture_of_an_encounter_shows_enough(tmp_path, monkeypatch, span):
    saved = []

    def save(figure, path):
        saved.append(figure)
        return path

    monkeypatch.setattr(figures, "save", save)
    seen = np.zeros((9, 2, 4))
    seen[:, 1, 1] = np.linspace(0.0, span, 9)
    window = encounter().window
    history = replace(window.history, states=seen)
    narrow = replace(encounter(), window=replace(window, history=history))
    found = forecasts([0.8, 0.4], [0.1, 0.2], [True, True])
    figures.recorded_encounter(narrow, found, tmp_path / "picture.png")
    (axes,) = saved[0].axes
    for low, high in (axes.get_xlim(), axes.get_ylim()):
        assert high - low >= 4.0
    lines = [
        line
        for line in axes.lines
        if line.get_color() == naming.colour_of("encounter-game-gamma-1")
    ]
    ends = [np.flatnonzero(~np.isnan(line.get_xdata()))[-1] for line in lines]
    assert ends == [10, 7]  # predictions end where the recording does
