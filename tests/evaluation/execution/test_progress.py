"""Progress where output is not a terminal: lines on standard error."""

import io
import time

from rich.console import Console

from evaluation.execution import progress
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Store


def trial(seed):
    if seed == 1:
        raise ValueError("no luck")
    time.sleep(0.1)
    return {"x": seed}


def study(folder, count):
    store = Store(folder, "s", {}, ("seed",))
    trials = [{"seed": k} for k in range(count)]
    return run_trials(trial, trials, store, workers=0, label="closed loop")


def test_lines_on_standard_error(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(progress, "PERIOD", 0.05)
    study(tmp_path, 3)
    capsys.readouterr()
    study(tmp_path, 7)
    told = capsys.readouterr()
    assert told.out == ""
    lines = told.err.splitlines()
    assert len(lines) > 2
    assert lines[0].startswith("closed loop: 3 of 7 trials, 1 failed, 0:00 elapsed")
    assert lines[-1] == "closed loop: 7 of 7 trials, 1 failed, 0:00 elapsed"
    assert all(line.startswith("closed loop: ") for line in lines)


def test_short_studies_print_one_line(tmp_path, capsys):
    study(tmp_path, 2)
    assert capsys.readouterr().err == "closed loop: 2 of 2 trials, 1 failed, 0:00 elapsed\n"


def test_time_left():
    lines = progress._Lines("closed loop", 40, 10, 1)
    assert lines.line(5.0) == "closed loop: 10 of 40 trials, 1 failed, 0:05 elapsed"
    lines.advance(False)
    lines.advance(True)
    told = "closed loop: 12 of 40 trials, 2 failed, 0:32 elapsed, about 7:28 left"
    assert lines.line(32.0) == told
    assert "1:02:05 elapsed" in lines.line(3725.0)


def test_a_bar_on_a_terminal(tmp_path, monkeypatch, capsys):
    screen = Console(file=io.StringIO(), force_terminal=True, width=100)
    monkeypatch.setattr("rich.get_console", lambda: screen)
    monkeypatch.setattr("rich.progress.get_console", lambda: screen)
    study(tmp_path, 2)
    assert capsys.readouterr().err == ""
    assert "closed loop" in screen.file.getvalue()
    assert "2/2" in screen.file.getvalue()
