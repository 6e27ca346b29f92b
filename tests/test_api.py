"""The names of `foresight_env` itself: loaded on first use, and known to type checkers."""

import importlib
import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import foresight_env

ROOT = Path(__file__).resolve().parent.parent

LOADED = """
import json, sys
import foresight_env
listed = sorted(set(foresight_env.__all__) - set(dir(foresight_env)))
print(json.dumps([listed, [name for name in ("jax", "numpy", "gymnasium") if name in sys.modules]]))
"""


def python(*arguments):
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True)


def test_importing_the_package_loads_no_jax():
    unlisted, loaded = json.loads(python("-c", LOADED).stdout)
    assert unlisted == []
    assert loaded == []


def test_every_name_is_that_of_a_room():
    rooms = [importlib.import_module(f"foresight_env.{r}") for r in ("games", "equilibrium")]
    rooms += [importlib.import_module(f"foresight_env.{r}") for r in ("inverse", "compilation")]
    for name in set(foresight_env.__all__) - {"__version__"}:
        assert any(getattr(foresight_env, name) is getattr(room, name, None) for room in rooms)
    assert isinstance(foresight_env.__version__, str)


def test_an_unknown_name():
    with pytest.raises(AttributeError, match="slove"):
        foresight_env.slove  # noqa: B018
    with pytest.raises(ImportError, match="slove"):
        exec("from foresight_env import slove")


def test_the_version_of_sources_that_are_not_installed(monkeypatch):
    def absent(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.version", absent)
    monkeypatch.delitem(vars(foresight_env), "__version__", raising=False)
    assert foresight_env.__version__ == "0+unknown"
    monkeypatch.delitem(vars(foresight_env), "__version__")


def test_type_checkers_know_the_names(tmp_path):
    names = ["solve", *(name for name in foresight_env.__all__ if name != "solve")]
    file = tmp_path / "user.py"
    lines = [f"from foresight_env import {', '.join(names)}", *(f"reveal_type({n})" for n in names)]
    file.write_text("\n".join([*lines, "from foresight_env import slove\n"]))
    options = ("--strict", "--config-file=", f"--cache-dir={tmp_path / 'cache'}")
    run = python("-m", "mypy", *options, "--follow-imports=silent", str(file))
    told = [line for line in run.stdout.splitlines() if "Revealed type" in line]
    assert len(told) == len(names), run
    assert "def (game: foresight_env.games.game.Game" in told[0]
    assert not [line for line in told if line.endswith('is "Any"')]
    errors = [line for line in run.stdout.splitlines() if ": error:" in line]
    assert len(errors) == 1, errors
    assert "slove" in errors[0]
