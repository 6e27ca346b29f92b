"""The command `foresight`: help, one-line errors with exit status 2, and results."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from evaluation.cli import app as command_line
from evaluation.cli.app import app
from evaluation.rollout.places import DEVELOPMENT_SEEDS, SETTINGS
from evaluation.samples.recording import write_sample
from foresight_env import __version__
from foresight_env.envs.rendering.style import COLOURS
from tests.support.made_walkers import write_walkers

COMMANDS = (
    "run",
    "evaluate crosswalk",
    "evaluate intersection",
    "evaluate prediction",
    "evaluate eth-ucy",
    "evaluate driving",
    "estimate",
    "demo",
    "benchmark",
    "value",
    "generate",
    "train",
    "export",
)


ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample"))


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    """The command chooses a cache through the environment; not for the tests after this one."""
    monkeypatch.setattr("foresight_env.compilation.enable_compilation_cache", lambda: None)
    monkeypatch.setenv("COLUMNS", "200")


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result, *told):
    """Exit status 2, one line that says what is wrong, nothing on standard output."""
    assert result.exit_code == 2, result.output
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    for part in told:
        assert part in lines[0]
    assert "Traceback" not in result.output
    assert result.stdout == ""


@pytest.mark.parametrize("command", COMMANDS)
def test_help(command):
    result = call(*command.split(), "--help")
    assert result.exit_code == 0
    assert "Usage: " in result.stdout
    assert "--out" in result.stdout
    assert call(*command.split(), "-h").stdout == result.stdout


def test_help_of_everything():
    result = call("--help")
    assert result.exit_code == 0
    assert all(command.split()[0] in result.stdout for command in COMMANDS)
    assert call("-h").stdout == result.stdout
    assert call("evaluate", "-h").stdout == call("evaluate", "--help").stdout != ""


def test_the_version():
    result = call("--version")
    assert result.exit_code == 0
    assert result.stdout == f"foresight_env {__version__}\n"


def test_help_loads_neither_jax_nor_arrow():
    script = (
        "import sys; sys.argv = ['foresight', {!r}]\n"
        "from evaluation.cli.app import main\n"
        "try:\n    main()\n"
        "finally:\n    assert not {{'jax', 'pyarrow', 'matplotlib'}} & set(sys.modules)\n"
    )
    for option in ("--help", "--version"):
        subprocess.run([sys.executable, "-c", script.format(option)], check=True, cwd=ROOT)


def test_predictions_on_recordings(tmp_path, sample):
    out = tmp_path / "out"
    arguments = ("evaluate", "prediction", "--data", sample.parent, "--workers", 0, "--out", out)
    refused(call(*arguments, "--predictors", "magic"), "--predictors: 'magic' is unknown")
    assert not out.exists()
    told = call(*arguments, "--predictors", "constant-velocity,constant-turn-rate")
    assert told.exit_code == 0, told.output
    assert "DUT, test: predictions" in told.stdout
    with Image.open(out / "error_over_time.png") as picture:
        assert picture.width > 100
    refused(call(*arguments, "--split", "development"), "no window in the recordings")


def test_a_report_of_nothing(tmp_path):
    refused(call("report", tmp_path / "out"), "holds no results")
    assert list(tmp_path.iterdir()) == []


def test_runs_that_there_are_not(tmp_path):
    out = tmp_path / "out"
    for arguments, told in (
        (("crosswalk", "--behaviour", "idm"), "--behaviour: idm drives cars"),
        (("intersection", "--players", 3), "--players: the intersection has two"),
        (("crosswalk", "--ego", "idm"), "--ego: idm drives cars"),
        (("crosswalk", "--scene", "merge"), "--scene: is merge; only the scenario driving"),
        (("intersection", "--scene", "left_turn"), "--scene: is left_turn"),
        (("crowd-9",), "setting: 'crowd-9' is unknown; choose from crosswalk"),
        (("crowd-3-far", "--players", 2), "--players: the setting crowd-3-far says how many"),
        (("crowd-3-far", "--behaviour", "idm"), "--behaviour: idm drives cars"),
    ):
        refused(call("run", *arguments, "--out", out), told)
    assert not out.exists()


def test_a_drive_is_drawn(tmp_path):
    out = tmp_path / "out"
    arguments = ("--ego", "constant-velocity", "--behaviour", "idm", "--players", 2)
    told = call("run", "driving", *arguments, "--scene", "lane_change", "--out", out)
    assert told.exit_code == 0, told.output
    assert "lane change, seed 0" in told.stdout
    with Image.open(out / "episode.gif") as film:
        assert film.n_frames > 20
        film.seek(10)
        pixels = np.asarray(film.convert("RGB"), dtype=int)
    for colour in COLOURS[:2]:  # of few pixels, and still its own
        assert (np.abs(pixels - colour).max(axis=2) < 16).sum() > 20


def test_egos_among_cars(tmp_path):
    """One episode each; what is there already is not run again, and nothing else is mixed in."""
    out = tmp_path / "out"
    arguments = ("evaluate", "driving", "--episodes", 1, "--cars", 2, "--workers", 0, "--out", out)
    refused(call(*arguments, "--egos", "magic"), "--egos: 'magic' is unknown")
    refused(call(*arguments, "--scenes", "moon"), "--scenes: 'moon' is unknown")
    assert not out.exists()
    arguments = (*arguments, "--scenes", "merge", "--others", "idm")
    told = call(*arguments, "--egos", "constant-velocity")
    assert told.exit_code == 0, told.output
    assert "merge, IDM/MOBIL cars" in told.stdout
    parts = sorted((out / "episodes").glob("part-*.parquet"))
    told = call(*arguments, "--egos", "idm,constant-velocity")
    assert told.exit_code == 0, told.output
    found = sorted((out / "episodes").glob("part-*.parquet"))
    assert found[: len(parts)] == parts
    assert len(found) == len(parts) + 1  # the new ego's
    with Image.open(out / "merge_idm.png") as picture:
        assert picture.width > 100
    refused(call(*arguments, "--noise-std", 0.2), "another configuration")


def test_a_missing_file(tmp_path):
    out = tmp_path / "out"
    refused(call("estimate", tmp_path / "no_obsmat.txt", "--out", out), "no_obsmat.txt")
    refused(call("demo", "--data", tmp_path / "no_obsmat.txt", "--out", out), "no_obsmat.txt")
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_something_else(tmp_path):
    junk = tmp_path / "junk.csv"
    junk.write_text("once upon a time\n")
    refused(call("estimate", junk, "--out", tmp_path / "out"), "junk.csv", "not recognised")
    assert list(tmp_path.iterdir()) == [junk]


def test_a_table_of_your_own(tmp_path):
    out, file = tmp_path / "out", write_walkers(tmp_path / "walkers.csv")
    table = ("estimate", file, "--columns", "time,person,x,y", "--rate", 10, "--out", out)
    told = call(*table, "--whole", "--collision-weight", 5)
    assert told.exit_code == 0, told.output
    assert re.search(r"ann +│ +0\.8\d │ +0\.8\d to 0\.9\d", told.stdout)
    with Image.open(out / "walkers_bob_ann_whole.png") as picture:
        assert picture.width > 100
    told = call(*table, "--observe", 2.8, "--collision-weight", 5)
    assert told.exit_code == 0, told.output
    assert re.search(r"ann +│ +[01]\.\d\d \[", told.stdout)
    assert (out / "walkers_bob_ann_part.png").exists()
    named = ("--columns", "agent=person", "--rate", 10)
    told = call("estimate", file, *named, "--no-pictures", "--out", out)
    assert told.exit_code == 0, told.output
    assert "constant-velocity" in told.stdout


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--columns", "time,person,x"), "--columns: is 'time,person,x'; expected the file's"),
        (("--columns", "time,person,x,y,time=t"), "--columns: names time twice"),
        (("--columns", "time,who,x,y", "--rate", 10), "walkers.csv:1: columns: agent is 'who'"),
        (("--columns", "time,person,x,y"), "rate: is missing"),
        (("--columns", "time,person,x,y", "--rate", 7), "walkers.csv:3: time is 0.1; expected"),
        (("--rate", 10), "not recognised"),
        (("--collision-weight", 5), "--collision-weight: needs --whole or --observe"),
        (("--whole", "--observe", 2), "--observe: --whole observes everything"),
    ],
)
def test_a_table_that_cannot_be_read(tmp_path, options, told):
    file = tmp_path / "walkers.csv"
    file.write_text("time,person,x,y\n0.0,ann,0,0\n0.1,ann,0.1,0\n")
    refused(call("estimate", file, *options, "--out", tmp_path / "out"), told)
    refused(call("demo", "--rate", 10), "--columns, --rate: need --data")
    refused(call("evaluate", "intersection", "--rate", 10), "--rate: need --data")
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("ids", "told"),
    [("ped:0,ped:77", "'ped:77'"), ("ped:0", "1 given"), ("ped:0,ped:0", "ids"), ("", "given")],
)
def test_wrong_ids(sample, tmp_path, ids, told):
    refused(call("estimate", sample, "--ids", ids, "--out", tmp_path / "out"), told)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [("--grid", 1, "at least 2 points"), ("--noise-std", "inf", "expected a finite number")],
)
def test_options_that_make_no_sense_leave_nothing_behind(tmp_path, option, value, told):
    out = tmp_path / "results"
    refused(call("evaluate", "crosswalk", option, value, "--out", out), option, told)
    assert not out.exists()


def test_nothing_to_evaluate(tmp_path):
    nothing = ("--episodes", 0, "--levels", 0, "--grid", 0)
    out = tmp_path / "results"
    refused(call("evaluate", "crosswalk", *nothing, "--out", out), "nothing to evaluate")
    assert not out.exists()


def test_egos_named_twice_count_once(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "evaluation.cli.demonstration.evaluate_crosswalk", lambda *a: asked.append(a)
    )
    result = call("evaluate", "crosswalk", "--egos", "oracle, assume-gamma-1,oracle")
    assert result.exit_code == 0, result.output
    assert asked[0][4] == ("oracle", "assume-gamma-1")


def test_the_value_of_information(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "evaluation.studies.value.study", lambda *given, **named: asked.append((given, named)) or []
    )
    result = call("value", "--settings", "all", "--seeds", "development", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    (_, settings, egos, seeds), named = asked[0]
    assert settings == tuple(SETTINGS)
    assert egos[-1] == "assume-gamma-1"
    assert seeds == DEVELOPMENT_SEEDS[:40]
    assert named["clairvoyant"]
    call("value", "--bound", "oracle", "--egos", "infer-gamma", "--episodes", 3, "--out", tmp_path)
    assert asked[1][0][1:] == (
        ("crowd-3-short",),
        ("oracle", "infer-gamma", "assume-gamma-1"),
        range(3),
    )
    assert not asked[1][1]["clairvoyant"]
    lines = call("value", "--list").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(SETTINGS)
    assert "crowd-3-far         crosswalk, others' gamma in (0.7, 1)" in lines
    refused(call("value", "--settings", "nowhere"), "--settings: 'nowhere' is unknown")
    refused(call("value", "--episodes", 900), "--episodes: is 900; there are 200 test seeds")


def test_the_command_alone_shows_its_help(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["foresight"])
    with pytest.raises(SystemExit) as end:
        command_line.main()
    told = capsys.readouterr()
    assert end.value.code == 2
    assert "Usage: " in told.out + told.err
    assert "foresight: " not in told.err


def test_an_oracle_infers_nothing(tmp_path):
    result = call("run", "crosswalk", "--ego", "oracle", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "gamma of agent 1: true" in result.stdout
    assert "inferred" not in result.stdout


def test_a_setting_is_run_by_its_name(tmp_path):
    result = call("run", "crowd-3-far", "--ego", "oracle", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    gammas = re.findall(r"gamma of agent (\d): true\D*([\d.]+)", result.stdout)
    assert [agent for agent, _ in gammas] == ["1", "2"]
    assert all(0.7 <= float(gamma) <= 1.0 for _, gamma in gammas)


def test_an_unknown_ego(tmp_path):
    result = call("run", "crosswalk", "--ego", "nosuch", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "'nosuch' is unknown; choose from oracle" in result.stderr
    result = call("evaluate", "crosswalk", "--egos", "oracle,nosuch", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "'nosuch' is unknown" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written(sample, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    study = ("evaluate", "crosswalk", "--episodes", 1, "--levels", 0, "--grid", 0, "--workers", 0)
    refused(call(*study, "--out", blocked / "out"), "cannot be written")
    result = call("estimate", sample, "--count", 1, "--out", blocked / "out")
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    assert "out" in result.stderr
    assert blocked.read_text() == "in the way"
    assert list(tmp_path.iterdir()) == [blocked]


def test_a_folder_of_another_study(tmp_path):
    (tmp_path / "closed_loop").mkdir()
    (tmp_path / "closed_loop" / "thesis.txt").write_text("dear reader")
    study = ("evaluate", "crosswalk", "--episodes", 1, "--levels", 0, "--grid", 0, "--workers", 0)
    refused(call(*study, "--out", tmp_path), "is not empty and has no manifest.json")


def test_an_interruption(tmp_path, monkeypatch, sample):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("evaluation.cli.demonstration.estimate_recorded", interrupted)
    result = call("estimate", sample, "--out", tmp_path)
    assert result.exit_code == 130
    assert result.stderr == "foresight: interrupted; finished trials are kept\n"


def test_estimate(sample, tmp_path):
    result = call("estimate", sample, "--ids", "ped:0,ped:1", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for word in ("encounter-game", "encounter-game-gamma-1", "constant-velocity", "ped:1"):
        assert word in result.stdout
    (picture,) = (tmp_path / "out").iterdir()
    assert picture.suffix == ".png"
    with Image.open(picture) as image:
        assert image.size == (1050, 900)
    quiet = call("estimate", sample, "--count", 1, "--no-pictures", "--out", tmp_path / "none")
    assert quiet.exit_code == 0
    assert not (tmp_path / "none").exists()
