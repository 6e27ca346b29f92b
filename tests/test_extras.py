"""Errors name the extra that has a missing dependency."""

import importlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from agents import make_ego, make_predictor
from agents.registry import ALL_PREDICTORS, CROSSWALK_EGOS, LEARNED
from evaluation.execution.local import results
from evaluation.execution.trial import Attempt
from foresight_env.datasets import open_recording, read_ucy
from foresight_env.datasets._table import csv_content
from foresight_env.extras import EXTRAS, MissingExtraError, require

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def without(monkeypatch):
    """Hide modules as if they were not installed."""

    def hide(*modules):
        for module in modules:
            monkeypatch.setitem(sys.modules, module, None)

    return hide


def test_the_extras_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra, provided in EXTRAS.items():
        listed = {
            re.match(r"[\w-]+", line)[0] for line in project["optional-dependencies"][extra]
        } - {"foresight_env"}
        assert set(provided.values()) <= listed, extra
    core = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}
    assert core.isdisjoint({d for provided in EXTRAS.values() for d in provided.values()})


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_that_is_missing_is_named(without, extra):
    without(*EXTRAS[extra])
    with pytest.raises(MissingExtraError, match=re.escape(f"foresight_env[{extra}]")) as told:
        require(extra, "this")
    assert all(distribution in str(told.value) for distribution in EXTRAS[extra].values())


def test_only_what_is_used_is_required(without):
    without("rich")
    require("evaluation", "this", "pyarrow")
    with pytest.raises(MissingExtraError, match="needs rich; "):
        require("evaluation", "this")


def test_learned_agents(without):
    without("equinox")
    for name in LEARNED:
        make = make_predictor if name in ALL_PREDICTORS else make_ego
        with pytest.raises(MissingExtraError, match=rf"{name}: .*\[learned\]"):
            make(name)
    with pytest.raises(MissingExtraError, match=r"\[learned\]"):
        make_ego("transformer+plan")
    for name in (set(ALL_PREDICTORS) | set(CROSSWALK_EGOS)) - set(LEARNED):
        (make_predictor if name in ALL_PREDICTORS else make_ego)(name)


def test_recordings(without, tmp_path):
    """UCY's blank-separated numbers need no extra."""
    without("pyarrow")
    clip = tmp_path / "clip_traj_ped_filtered.csv"
    clip.write_text("id,frame,label,x_est,y_est,vx_est,vy_est\n0,0,ped,0,0,0,0\n")
    with pytest.raises(MissingExtraError, match=r"clip.*\[evaluation\]"):
        open_recording(clip)
    with pytest.raises(MissingExtraError, match=r"\[evaluation\]"):
        csv_content({"id": np.arange(2)})
    (tmp_path / "obsmat.txt").write_text("0 1 0 0 0 1 0 0\n10 1 1 0 0 1 0 0\n")
    assert read_ucy(tmp_path / "obsmat.txt").tracks


def test_a_cluster(without):
    without("distributed")
    with pytest.raises(MissingExtraError, match=r"--cluster: .*\[cluster\]"):
        results(Attempt(dict, ("seed",)), [], "tcp://127.0.0.1:1")


HIDDEN = """
import sys
for name in {names!r}:
    sys.modules[name] = None
sys.argv = ["foresight", *{arguments!r}]
from evaluation.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("names", "arguments", "extra"),
    [
        (["typer"], ["demo"], "evaluation"),
        (["pyarrow"], ["--help"], "evaluation"),
        (["equinox"], ["train", "gamma"], "learned"),
        (["torch"], ["train", "ppo"], "rl"),
        (["equinox"], ["run", "crosswalk", "--ego", "cloned"], "learned"),
        (["equinox"], ["evaluate", "prediction", "--predictors", "social-lstm"], "learned"),
        (["equinox"], ["benchmark", "--egos", ""], "learned"),
    ],
)
def test_the_command_ends_in_one_line(tmp_path, names, arguments, extra):
    code = HIDDEN.format(names=names, arguments=arguments)
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 2, run
    assert run.stdout == ""
    assert len(run.stderr.splitlines()) == 1, run.stderr
    assert f"foresight_env[{extra}]" in run.stderr
    assert not list(tmp_path.iterdir())


def test_reinforcement_without_its_extra(without, monkeypatch):
    without("torch")
    monkeypatch.delitem(sys.modules, "evaluation.training.reinforcement", raising=False)
    with pytest.raises(MissingExtraError, match=r"\[rl\]"):
        importlib.import_module("evaluation.training.reinforcement")
