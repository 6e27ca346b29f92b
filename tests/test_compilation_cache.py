"""Compiled programs are kept where asked, and long compilations are announced."""

import os
import subprocess
import sys
from contextlib import nullcontext

import jax
import pytest

from foresight_env import compilation

KEEPING = """
import sys
import foresight_env
folder = foresight_env.enable_compilation_cache(*sys.argv[1:])
import jax, os
assert jax.config.jax_compilation_cache_dir == str(folder)
assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(folder)
from foresight_env import solve
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game
m = MONTE_CARLO
assert solve(crosswalk_game(2, 5), m.initial_state, m.theta, m.gamma).status == 0
print(folder)
"""


def test_programs_are_kept_and_found_again(tmp_path):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["XDG_CACHE_HOME"] = str(tmp_path)

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, "-c", KEEPING, *arguments],
            env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        return done.stdout.split()[-1]

    folder = tmp_path / "foresight_env" / "jax"
    assert run() == str(folder)
    kept = {p.name: p.stat().st_mtime_ns for p in folder.iterdir() if not p.name.endswith("atime")}
    assert kept
    assert run() == str(folder)
    again = {p.name: p.stat().st_mtime_ns for p in folder.iterdir() if not p.name.endswith("atime")}
    assert again == kept  # nothing was compiled a second time


def test_the_users_choice_of_a_folder_counts(monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "own"))
    assert compilation.default_cache() == tmp_path / "own"
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compilation.default_cache() == tmp_path / "foresight_env" / "jax"


class FakeTimer:
    """Timer that the test fires itself; `cancel` stops it."""

    def __init__(self, seconds, function):
        self.function = function
        self.daemon = False

    def start(self):
        FakeTimer.running = self

    def cancel(self):
        FakeTimer.running = None


@pytest.mark.parametrize(("ended", "within", "lines"), [(0, 1, 1), (1, 1, 0), (0, 0, 0)])
def test_compilations_are_announced_where_they_last(monkeypatch, ended, within, lines):
    monkeypatch.setattr(compilation.threading, "Timer", FakeTimer)
    told = []
    with compilation.announce_compilation(told.append) if within else nullcontext():
        compilation._listen("/jax/core/compile/jaxpr_to_mlir_module_duration", 0.1)
        if ended:
            compilation._listen("/jax/core/compile/backend_compile_duration", 0.1)
        if FakeTimer.running is not None:
            FakeTimer.running.function()
            FakeTimer.running.function()  # of another program: one line is enough
    assert len(told) == lines
    assert all("compiling the solver" in line for line in told)
    compilation._listen("/jax/core/compile/backend_compile_duration", 0.1)


def test_jax_sends_the_events_that_are_listened_for():
    seen = []
    jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__: seen.append(name))
    jax.jit(lambda v: v * 1.2345 + seen.__len__())(1.0)
    assert any(name.endswith("jaxpr_to_mlir_module_duration") for name in seen)
    assert any(name.endswith("backend_compile_duration") for name in seen)
