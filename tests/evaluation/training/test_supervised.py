"""From `foresight generate` to `foresight train` to a prediction; what may not be learned from."""

import csv
import json
from dataclasses import replace
from itertools import pairwise
from shutil import copytree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from agents.egos.predict_then_plan import history_of
from agents.learned.features import AHEAD, features_of, targets_of
from agents.learned.predictor import LearnedPredictor
from agents.learned.reactive import ReactiveEgo
from evaluation.cli.app import app
from evaluation.execution.store import Store
from evaluation.rollout.episode import observed_states
from evaluation.rollout.places import setting_of
from evaluation.samples.recording import write_sample
from evaluation.training.examples import mirrored, recorded_scenes, simulated_scenes
from evaluation.training.generation import (
    COLUMNS,
    FIRST_SEED,
    MOST,
    episodes_in,
    generate,
    run_trial,
)
from evaluation.training.supervised import calibration, forecast_data
from evaluation.windows.interaction import LEAST_OBSERVED, STEP_SECONDS
from foresight_env.datasets import open_recording


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result, told):
    assert result.exit_code == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert told in lines[0]


@pytest.fixture(scope="module")
def episodes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("episodes")
    for split, count in (("train", 3), ("validation", 2)):
        told = call(
            "generate", "crosswalk", "--episodes", count, "--split", split, "--workers", 0,
            "--out", folder,
        )  # fmt: skip
        assert told.exit_code == 0, told.output
        assert f"episodes: {count} in" in told.stdout
    return folder


def seen_in(row):
    """Observed states (steps, players, 4) of an episode."""
    observations = np.array(row["observations"]).reshape(row["steps"], -1)
    return observed_states(observations, row["ego"], row["players"])


def test_no_seed_is_in_two_splits():
    first = sorted(FIRST_SEED.values())
    assert all(low + MOST <= high for low, high in pairwise(first))
    assert min(first) > MOST  # the benchmark's


def test_an_episode_holds_the_truth_and_what_was_seen(episodes):
    row = episodes_in(episodes / "train", "train")[0]
    steps, count = row["steps"], row["players"]
    states = np.array(row["states"]).reshape(steps + 1, count, 4)
    seen = seen_in(row)
    assert seen.shape == (steps, count, 4)
    assert np.std(seen - states[:-1]) == pytest.approx(0.05, rel=0.2)
    controls = np.array(row["controls"]).reshape(steps, count, 2)
    np.testing.assert_allclose(np.diff(states[..., 2:], axis=0), 0.1 * controls, atol=1e-6)
    assert row["gamma"][0] == 0.95
    assert 0.3 <= row["gamma"][1] <= 1.0
    np.testing.assert_allclose(
        np.array(row["observations"]).reshape(steps, -1)[:, -2:] - np.array(row["goals"][:2]),
        0.0,
        atol=1e-5,
    )
    again = run_trial("crosswalk", row["seed"])
    assert all(again[name] == row[name] for name in again)


def test_episodes_are_kept_and_splits_stay_apart(episodes):
    before = episodes_in(episodes / "train", "train")
    assert generate(episodes / "train", ("crosswalk",), 2, "train", 0) == before[:2]
    assert episodes_in(episodes / "train", "train") == before
    with pytest.raises(ValueError, match="holds results of another study"):
        episodes_in(episodes / "train", "validation")
    with pytest.raises(ValueError, match="split: is 'exam'"):
        generate(episodes / "exam", ("crosswalk",), 1, "exam")
    with pytest.raises(ValueError, match=f"episodes: is {MOST + 1}"):
        generate(episodes / "many", ("crosswalk",), MOST + 1, "train")
    assert not (episodes / "exam").exists()
    assert not (episodes / "many").exists()


def test_episodes_of_other_code_can_be_used_and_not_extended(episodes, tmp_path, monkeypatch):
    folder = tmp_path / "train"
    copytree(episodes / "train", folder)
    monkeypatch.setattr("evaluation.execution.store.code_digest", lambda: "0123")
    assert episodes_in(folder, "train") == episodes_in(episodes / "train", "train")
    with pytest.raises(ValueError, match="holds results of other code"):
        generate(folder, ("crosswalk",), 4, "train", 0)


def test_episodes_without_a_column_are_refused(tmp_path):
    rows = [{name: 0 for name in COLUMNS if name != "controls"} | {"error": ""}]
    Store(tmp_path, "episodes, train", {}, ("place", "seed")).append(rows)
    with pytest.raises(ValueError, match="lacks the columns controls; generate it again"):
        episodes_in(tmp_path, "train")


def test_scenes_of_an_episode_are_what_happened(episodes):
    """Inputs are observed by then, with noise; targets come after, without."""
    row = episodes_in(episodes / "train", "train")[0]
    states = np.array(row["states"]).reshape(row["steps"] + 1, row["players"], 4)
    every = round(STEP_SECONDS / row["dt"])
    scene = setting_of(row["place"]).make().scene
    assert scene.dt == row["dt"]
    found = list(simulated_scenes(row))
    for place, one in enumerate(found):
        moment = (LEAST_OBSERVED - 1 + place) * every
        seen = seen_in(row)[max(moment % every, moment - 7 * every) : moment + 1 : every]
        history = replace(history_of(scene, tuple(seen)), dt=every * row["dt"])
        features, frames = features_of(history)
        target, known = targets_of(frames, states[moment + every :: every, :, :2], history.dt)
        np.testing.assert_array_equal(one.seen.past[0], features.past)
        np.testing.assert_array_equal(one.target[0], target)
        np.testing.assert_array_equal(one.known[0], known)
    assert len(found) > 2


def test_a_mirror_has_no_second_image(episodes):
    scenes = forecast_data([episodes], None, "train")
    twice = mirrored(mirrored(scenes))
    np.testing.assert_array_equal(twice.target, scenes.target)
    np.testing.assert_array_equal(twice.seen.past, scenes.seen.past)
    assert not np.array_equal(mirrored(scenes).target, scenes.target)


def test_recordings_for_tests_are_not_learned_from(tmp_path):
    file = write_sample(tmp_path)
    recording = open_recording(str(file))
    assert recording.name
    with pytest.raises(ValueError, match="is for tests; nothing is learned from it"):
        next(recorded_scenes(recording, "train"))


@pytest.mark.parametrize("name", ["transformer", "cloned"])
def test_from_episodes_to_weights(episodes, tmp_path, name):
    arguments = ("train", name, "--episodes", episodes, "--epochs", 2, "--batch", 16)
    told = call(*arguments, "--out", tmp_path)
    assert told.exit_code == 0, told.output
    assert "epoch 1: " in told.stdout
    folder = tmp_path / name
    about = json.loads((folder / f"{name}.json").read_text())
    assert about["network"] == name
    assert about["epochs"] == 2
    with (folder / "curve.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2
    with Image.open(folder / "curve.png") as picture:
        assert picture.width > 100
    weights = str(folder / f"{name}.safetensors")
    data = (folder / f"{name}.safetensors").read_bytes()
    again = call(*arguments, "--out", tmp_path)  # there is nothing left to do
    assert "epoch" not in again.stdout.split("kept")[0]
    assert (folder / f"{name}.safetensors").read_bytes() == data
    if name == "cloned":
        assert ReactiveEgo(name, weights) != ReactiveEgo(name)
        return
    scene = setting_of("crosswalk").make().scene
    row = episodes_in(episodes / "validation", "validation")[0]
    history = history_of(scene, tuple(seen_in(row)[:8]))
    found = LearnedPredictor(name, weights).predict(history, 12)
    assert found.positions.shape[1:] == (12, 2, 2)


def test_calibration_finds_the_factor():
    """Of a network that says 1/2 m where the truth has 1 m: twice."""
    import jax.numpy as jnp

    from agents.learned.features import Features
    from agents.learned.head import Futures
    from evaluation.training.examples import Examples

    random = np.random.default_rng(0)
    target = random.normal(size=(200, 2, AHEAD, 2)).astype(np.float32)
    known = np.ones((200, 2, AHEAD), bool)
    blank = np.zeros((200, 1), np.float32)

    def network(seen):
        del seen
        return Futures(jnp.zeros((1, 2, AHEAD, 2)), jnp.full((1, 2, AHEAD, 2), 0.5), jnp.zeros(1))

    data = Examples(Features(*(blank for _ in Features._fields)), target, known)
    assert calibration(network, data) == pytest.approx(2.0, rel=0.04)


def test_what_cannot_be_trained_or_made(tmp_path, episodes):
    out = tmp_path / "out"
    for arguments, told in (
        (("train", "magic"), "NAME: 'magic' is unknown"),
        (("train", "gamma", "--episodes", tmp_path / "none"), "holds no episodes; make them"),
        (("train", "gamma", "--data", tmp_path), "--data: gamma learns from episodes only"),
        (
            ("train", "hybrid-game", "--data", tmp_path, "--episodes", "mine"),
            "--episodes: hybrid-game learns from --data alone",
        ),
        (("train", "transformer", "--episodes", ""), "hold nothing to learn from"),
        (("generate", "moon"), "SCENARIOS: 'moon' is unknown"),
        (("generate", "crosswalk", "--split", "exam"), "--split: is 'exam'"),
    ):
        refused(call(*arguments, "--out", out), told)
        assert not out.exists()
