"""`foresight evaluate eth-ucy` and `foresight export`."""

import pytest

from evaluation.cli.protocols import DEFAULT, SCENE_NAMES
from evaluation.reports.page import write_report
from evaluation.windows.eth_ucy import SCENES
from tests.evaluation.cli.test_app import call, environment, refused  # noqa: F401
from tests.support.made_scenes import write_scenes


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scenes(tmp_path_factory.mktemp("scenes"))


def test_the_names_of_scenes():
    assert tuple(SCENES) == SCENE_NAMES


def test_the_protocol(tmp_path, data):
    out = tmp_path / "out"
    arguments = ("evaluate", "eth-ucy", "--data", data, "--workers", 0, "--out", out)
    refused(call(*arguments, "--predictors", "magic"), "--predictors: 'magic' is unknown")
    refused(call(*arguments, "--scenes", "zara3"), "--scenes: 'zara3' is unknown")
    refused(
        call(*arguments, "--predictors", "transformer", "--weights", tmp_path),
        "eth/transformer.safetensors: is missing",
    )
    assert not out.exists()
    told = call(*arguments, "--predictors", f"{DEFAULT[0]},kalman", "--every", 2)
    assert told.exit_code == 0, told.output
    assert "published: STAR-D" in told.stdout
    assert "one window in 2: not the protocol" in told.stdout
    for name in ("eth_ucy.csv", "eth_ucy.md", "reliability.png"):
        assert (out / name).stat().st_size > 500
    page = write_report(out).read_text()
    assert "one scene left out" in page
    assert "published: STAR-D" in page


def test_export(tmp_path, data):
    told = call("export", data, "--out", tmp_path / "out")
    assert told.exit_code == 0, told.output
    assert "agents that count: 45" in told.stdout
    assert (tmp_path / "out" / "tensors.npz").exists()
    refused(call("export", tmp_path / "none", "--out", tmp_path / "out2"), "no such file")
