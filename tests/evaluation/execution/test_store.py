"""Results on disk: whole or not at all, resumed, and refused where they do not belong."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import pytest

import evaluation.execution.store as store_module
from evaluation.execution.code import code_digest
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Store, StoreError, read_results
from evaluation.execution.trial import Attempt
from evaluation.studies import closed_loop, estimation
from foresight_env.files import write_atomically
from tests.support import stand_in_study as stand_in

ROWS = stand_in.SEEDS * len(stand_in.EGOS)


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_rows_come_back_as_they_were(tmp_path):
    store = Store(tmp_path / "new" / "folder", "s", {"k": (1, 2)}, ("seed",))
    rows = [{"seed": s, "x": 0.1 * s, "list": [s] * s, "none": None, "text": "ä"} for s in (2, 0)]
    store.append(rows)
    store.append([])
    store.append([{"seed": 1, "x": 5.0, "list": [], "none": None, "text": ""}])
    found = Store(tmp_path / "new" / "folder", "s", {"k": [1, 2]}, ("seed",)).rows()
    assert [r["seed"] for r in found] == [0, 1, 2]
    assert found[2] == rows[0]
    assert found[0] == rows[1]
    assert store.finished() == {(0,), (1,), (2,)}
    assert names(store.folder) == ["manifest.json", "part-000000.parquet", "part-000001.parquet"]


def test_two_writers_lose_nothing(tmp_path, monkeypatch):
    """The second finds the name taken that it has just counted as free, and takes the next."""
    mine, theirs = (Store(tmp_path, "s", {}, ("seed",)) for _ in range(2))
    mine.append([{"seed": 10}])
    once = write_atomically

    def overtaken(path, data, *, overwrite):
        monkeypatch.setattr(store_module, "write_atomically", once)
        theirs.append([{"seed": 9}, {"seed": 11}])
        once(path, data, overwrite=overwrite)

    monkeypatch.setattr(store_module, "write_atomically", overtaken)
    mine.append([{"seed": 11, "x": 1}])
    assert [r["seed"] for r in mine.rows()] == [9, 10, 11]
    assert len(list(tmp_path.glob("part-*"))) == 3
    # A reader of the folder without the study finds every trial once, too.
    assert sorted((r["seed"], r["x"]) for r in read_results(tmp_path).rows if r["x"]) == [(11, 1)]
    assert len(read_results(tmp_path).rows) == 3
    assert not [name for name in names(tmp_path) if name.startswith(".")]


def test_manifest(tmp_path):
    Store(tmp_path, "s", {"noise": 0.5}, ("seed",))
    told = json.loads((tmp_path / "manifest.json").read_text())
    assert told["study"] == "s"
    assert told["configuration"] == {"noise": 0.5}
    assert told["code"] == code_digest()
    assert {"version", "python", "machine"} <= told.keys()


@pytest.mark.parametrize("failing", ["replace", "fsync"])
def test_a_write_that_fails_leaves_nothing_half_done(tmp_path, monkeypatch, failing):
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def broken(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, failing, broken)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["file"]


def test_a_full_disk_is_told_with_the_file(tmp_path, monkeypatch):
    store = Store(tmp_path, "s", {}, ("seed",))

    def broken(*args, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_module, "write_atomically", broken)
    with pytest.raises(StoreError, match=r"part-000000\.parquet: cannot be written \(No space"):
        store.append([{"seed": 0}])


@pytest.mark.parametrize(
    ("study", "configuration", "code", "told"),
    [
        ("other", {"a": 1}, None, "another study"),
        ("s", {"a": 2}, None, r"another configuration \(a\)"),
        (
            "s",
            {"a": 1},
            "0123",
            r"other code \([0-9a-f]{16}; this is 0123\); choose another folder",
        ),
    ],
)
def test_other_results_are_refused(tmp_path, monkeypatch, study, configuration, code, told):
    Store(tmp_path, "s", {"a": 1}, ("seed",)).append([{"seed": 0}])
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    if code:
        monkeypatch.setattr(store_module, "code_digest", lambda: code)
    with pytest.raises(StoreError, match=told):
        Store(tmp_path, study, configuration, ("seed",))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_results_of_other_code_can_be_read(tmp_path, monkeypatch):
    Store(tmp_path, "s", {}, ("seed",)).append([{"seed": 0}])
    monkeypatch.setattr(store_module, "code_digest", lambda: "0123")
    found = read_results(tmp_path)
    assert found.rows == [{"seed": 0}]
    assert found.code == code_digest() != "0123"


def test_results_without_a_digest_are_refused(tmp_path):
    Store(tmp_path, "s", {}, ("seed",))
    told = json.loads((tmp_path / "manifest.json").read_text())
    del told["code"]
    (tmp_path / "manifest.json").write_text(json.dumps(told))
    with pytest.raises(StoreError, match=r"other code \(unknown; this is"):
        Store(tmp_path, "s", {}, ("seed",))
    assert read_results(tmp_path).code == "unknown"


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.txt").write_text("dear reader")
    with pytest.raises(StoreError, match=r"is not empty and has no manifest\.json"):
        Store(tmp_path, "s", {}, ("seed",))
    assert names(tmp_path) == ["thesis.txt"]


def test_a_kill_before_the_manifest_is_no_obstacle(tmp_path):
    (tmp_path / ".manifest.json.x1y2").write_text("{")
    assert Store(tmp_path, "s", {}, ("seed",)).rows() == []


def test_a_file_in_the_place_of_the_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        Store(tmp_path / "file" / "results", "s", {}, ("seed",))


def test_damage_is_named(tmp_path):
    store = Store(tmp_path, "s", {}, ("seed",))
    for seed in range(2):
        store.append([{"seed": seed}])
    part = tmp_path / "part-000001.parquet"
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(StoreError, match=r"part-000001\.parquet: is damaged .*delete this part"):
        store.rows()
    part.unlink()
    assert store.finished() == {(0,)}
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(StoreError, match=r"manifest\.json: is not JSON"):
        Store(tmp_path, "s", {}, ("seed",))


def test_only_missing_trials_are_run(tmp_path):
    whole = stand_in.study(tmp_path / "whole")
    assert len(whole) == ROWS
    part = stand_in.study(tmp_path / "parts", seeds=5)
    assert len(part) == 5 * len(stand_in.EGOS)
    ran = []

    def counted(**trial):
        ran.append((trial["ego"], trial["seed"]))
        return stand_in.trial(**trial)

    store = Store(tmp_path / "parts", "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
    trials = [
        {"ego": e, "seed": s, "seconds": 0.0} for s in range(stand_in.SEEDS) for e in stand_in.EGOS
    ]
    rows = run_trials(counted, trials, store, workers=0, label="counted")
    assert sorted(ran) == sorted((e, s) for e in stand_in.EGOS for s in range(5, stand_in.SEEDS))
    assert rows == whole
    fewer = run_trials(counted, trials[:3], store, workers=0, label="counted")
    assert [(r["ego"], r["seed"]) for r in fewer] == [("a", 0), ("a", 1), ("b", 0)]


def test_studies_can_be_extended(tmp_path, monkeypatch):
    """More seeds, egos, levels or sequences go into the same folder, others settings do not."""
    asked = []

    def episode(ego, settings, seed, **setting):
        asked.append((ego, seed))
        return {"x": 1}

    monkeypatch.setattr(closed_loop, "run_trial", episode)
    for egos, seeds in ((("oracle",), 2), (("oracle", "infer-gamma"), 3), (("infer-gamma",), 1)):
        rows = closed_loop.study(tmp_path / "loop", egos, range(seeds), workers=0)
        assert {(r["ego"], r["seed"]) for r in rows} == {(e, s) for e in egos for s in range(seeds)}
    assert len(asked) == len(set(asked)) == 6
    with pytest.raises(StoreError, match=r"another configuration \(noise_std, players\)"):
        closed_loop.study(
            tmp_path / "loop", egos, range(2), closed_loop.ClosedLoop(3, noise_std=0.1)
        )
    monkeypatch.setattr(estimation, "run_sequence", lambda **trial: {"x": 1})
    for levels, sequences in ((2, 1), (3, 2), (2, 2)):
        rows = estimation.study(tmp_path / "noise", levels, sequences, workers=0)
        assert len(rows) == levels * sequences * 4


def test_a_failing_trial_is_a_row(tmp_path):
    rows = stand_in.study(tmp_path)
    failed = [r for r in rows if r["error"]]
    assert [(r["ego"], r["seed"]) for r in failed] == [(e, s) for e in "ab" for s in (5, 11)]
    for row in failed:
        assert row["error"].startswith(
            f"ArithmeticError: no luck with {row['seed']} (stand_in_study.py:"
        )
        assert row["value"] is None
    assert all(r["value"] is not None for r in rows if not r["error"])
    alone = Attempt(stand_in.trial, ("seed",))({"ego": "a", "seed": 5, "seconds": 0.0})
    assert alone.keys() == {"seed", "error"}


def test_an_interruption_keeps_what_was_finished(tmp_path):
    store = Store(tmp_path, "s", {}, ("seed",))

    def interrupted(seed):
        if seed == 5:
            raise KeyboardInterrupt
        return {"x": seed}

    trials = [{"seed": s} for s in range(8)]
    with pytest.raises(KeyboardInterrupt):
        run_trials(interrupted, trials, store, workers=0, label="s", chunk=4)
    assert store.finished() == {(s,) for s in range(5)}


def test_killed_at_random_moments_and_run_again(tmp_path):
    """The rows end up the same as those of an undisturbed run."""
    wanted = stand_in.study(tmp_path / "undisturbed")
    folder = tmp_path / "killed"
    chance = random.Random(0)
    script = [sys.executable, "-m", stand_in.__name__, str(folder)]
    seen = set()
    for _ in range(10):
        process = subprocess.Popen(
            [*script, "0", "0.05"], stdout=subprocess.DEVNULL, start_new_session=True
        )
        # From the moment that it has begun, not from that of importing.
        while not folder.exists() and process.poll() is None:
            time.sleep(0.005)
        time.sleep(chance.uniform(0.0, 0.2))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if (folder / "manifest.json").exists():
            store = Store(folder, "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
            finished = store.finished()
            assert seen <= finished
            seen = finished
    assert len(seen) < ROWS, "nothing was left to do: the kills came too late to test anything"
    last = subprocess.run([*script, "0", "0"], capture_output=True, text=True, check=False)
    assert last.returncode == 0, last.stderr
    store = Store(folder, "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
    assert store.rows() == wanted


def test_an_interrupt_ends_a_study_at_once(tmp_path):
    script = [sys.executable, "-m", stand_in.__name__, str(tmp_path / "study"), "2", "2.0"]
    process = subprocess.Popen(
        script, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    # All trials together would take 24 s; the interrupt comes once the first have been stored.
    while not list(tmp_path.glob("study/part-*")) and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    assert process.wait(timeout=60) != 0
    assert time.monotonic() - begin < 10.0
    store = Store(tmp_path / "study", "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
    assert 3 <= len(store.finished()) < ROWS


def test_a_fresh_study_forgets_the_old_one(tmp_path):
    Store(tmp_path, "s", {"k": 1}, ("seed",)).append([{"seed": 0}])
    (tmp_path / "notes.txt").write_text("mine")
    store = Store(tmp_path / "other", "s", {}, ("seed",))
    assert Store(tmp_path / "other", "s", {"new": 1}, ("seed",), fresh=True).rows() == []
    assert store.folder.exists()
    with pytest.raises(StoreError, match=r"holds results|is not empty"):
        Store(tmp_path, "s", {"k": 2}, ("seed",))


def test_worker_processes_give_the_same_rows(tmp_path):
    wanted = stand_in.study(tmp_path / "here")
    script = [sys.executable, "-m", stand_in.__name__, str(tmp_path / "there"), "2", "0"]
    subprocess.run(script, check=True, capture_output=True)
    there = Store(tmp_path / "there", "stand-in", {"seeds": stand_in.SEEDS}, stand_in.KEY)
    assert there.rows() == wanted
