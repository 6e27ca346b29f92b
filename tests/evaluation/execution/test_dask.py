"""Studies on a Dask cluster: a real scheduler, real worker processes."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support import stand_in_study as stand_in

pytest.importorskip("distributed")

from evaluation.execution.local import results
from evaluation.execution.store import Store
from evaluation.execution.trial import Attempt

ROOT = Path(stand_in.__file__).parents[2]
ATTEMPT = Attempt(stand_in.trial, stand_in.KEY)
HERE = {**os.environ, "PYTHONPATH": str(ROOT)}


def started(*arguments):
    """A process of Dask's."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        env=HERE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@pytest.fixture
def scheduler():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = started("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    yield f"tcp://127.0.0.1:{port}"
    process.kill()
    process.wait()


@pytest.fixture
def worker(scheduler):
    """Starts workers; all are gone at the end."""
    processes = []

    def start(*arguments):
        processes.append(started("worker", scheduler, "--no-nanny", "--no-dashboard", *arguments))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


def test_a_worker_that_is_killed_costs_no_row(tmp_path, scheduler, worker):
    wanted = stand_in.study(tmp_path / "here")
    first, _ = (worker("--nthreads", "1") for _ in range(2))
    study = subprocess.Popen(
        [sys.executable, "-m", stand_in.__name__, str(tmp_path / "there"), scheduler, "0.3"],
        env=HERE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    while not list(tmp_path.glob("there/part-*")) and study.poll() is None:
        time.sleep(0.05)
    first.send_signal(signal.SIGKILL)
    assert study.poll() is None, "the study ended before the kill"
    assert study.wait(timeout=60) == 0
    there = Store(tmp_path / "there", "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
    assert there.rows() == wanted


def test_workers_that_cannot_be_used(scheduler, worker, monkeypatch):
    monkeypatch.setattr("evaluation.execution.dask.PATIENCE", 1.0)
    with pytest.raises(OSError, match="no Dask scheduler answers at"):
        next(results(ATTEMPT, [{}], "tcp://127.0.0.1:9"))
    monkeypatch.setattr("evaluation.execution.dask.PATIENCE", 20.0)
    worker("--nthreads", "2")
    with pytest.raises(OSError, match="has 2 threads; start them with --nthreads 1"):
        next(results(ATTEMPT, [{}], scheduler))


def test_workers_with_other_code(scheduler, worker, monkeypatch):
    here = os.getpid()
    monkeypatch.setattr(
        "evaluation.execution.dask.code_digest",
        lambda: "0123" if os.getpid() == here else "4567",
    )
    worker("--nthreads", "1")
    with pytest.raises(OSError, match=r"have other code of foresight_env \(4567\); expected 0123"):
        next(results(ATTEMPT, [{}], scheduler))


def test_without_workers(scheduler, monkeypatch):
    monkeypatch.setattr("evaluation.execution.dask.PATIENCE", 5.0)
    with pytest.raises(OSError, match="has no workers; start some: dask worker"):
        next(results(ATTEMPT, [{}], scheduler))
