"""Training of `hybrid-game`: what it learns from, and that an interruption changes nothing."""

from dataclasses import fields, replace
from functools import partial

import jax
import numpy as np
import pytest

from agents.hybrid.futures import GameUse, deviations, joint_futures
from agents.hybrid.network import COEFFICIENTS, MODES, ProposalNetwork
from agents.hybrid.smooth_game import positions
from agents.hybrid.strategies import GAME_BASIS
from agents.learned.training import Trained
from agents.learned.weights import arrays_of
from evaluation.training import hybrid, hybrid_data
from evaluation.training.hybrid import (
    PROPOSING,
    Fold,
    TrainingData,
    all_but_anchors,
    anchors_of,
    learn_hybrid,
    traits_alone,
    with_share,
)
from evaluation.training.hybrid_data import CLOSE, PARTS, close, leave_one_out, recorded
from evaluation.training.hybrid_examples import recorded_examples, stacked, window_examples
from evaluation.windows.eth_ucy import read_scene_file
from tests.support.made_recordings import walk
from tests.support.made_scenes import crossing, straight, write_scenes

LONG = 60
"""Rows of made recordings: 24 s."""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scenes(tmp_path_factory.mktemp("scenes"), partial(crossing, rows=LONG))


def test_examples_are_what_was_recorded():
    recording = crossing("zara01", rows=LONG)
    examples = stacked(list(recorded_examples(recording)))
    whole = examples.known.all(axis=-1)
    assert whole.any()
    # In straight motion everything is where the frames' velocities lead.
    frames = examples.scene.frames
    times = 0.4 * np.arange(1, 13)
    line = frames.place[:, :, None] + times[:, None] * frames.velocity[:, :, None]
    np.testing.assert_allclose(examples.target[whole], line[whole], atol=1e-3)
    np.testing.assert_allclose(
        np.linalg.norm(frames.velocity[whole], axis=-1).max(), 1.2, atol=1e-3
    )
    # Parts share no step.
    for part, span in PARTS.items():
        found = stacked(list(recorded_examples(recording, span=span)))
        assert 0 < len(found.known) < len(examples.known), part


def test_the_held_out_scene_is_left_out(data, monkeypatch):
    read = []

    def examples(recording, *args):
        read.append(recording.name)
        return recorded_examples(recording, *args)

    monkeypatch.setattr(hybrid_data, "recorded_examples", examples)
    monkeypatch.setattr(hybrid_data, "LONG", 1.0)  # both parts are of every recording
    leave_one_out(data, "zara1")
    assert set(read) == {"eth", "hotel", "students03", "zara02"}
    read.clear()
    recorded(data)
    assert set(read) == {"eth", "hotel", "students03", "zara01"}  # zara02 is for tests


def test_each_recording_is_held_out_once_to_calibrate(data, monkeypatch):
    monkeypatch.setattr(hybrid_data, "LONG", 1.0)  # parts are of every recording
    folds = recorded(data).folds
    assert len(folds) == hybrid_data.FOLDS
    recordings = [r for r in hybrid_data._recordings(data) if r.name != "zara02"]  # for tests
    windows = [list(window_examples(r)) for r in recordings]
    learned = [
        len(list(recorded_examples(r, span=PARTS["train"], phases=hybrid_data.PHASES)))
        + hybrid_data.WINDOWS * len(list(window_examples(r, span=PARTS["train"])))
        for r in recordings
    ]
    for k, fold in enumerate(folds):
        held = list(range(k, len(recordings), hybrid_data.FOLDS))
        assert [int(np.sum(fold.recording == n)) for n in range(len(held))] == [
            len(windows[i]) for i in held
        ]
        first = windows[held[0]][0]
        np.testing.assert_array_equal(fold.held.target[0], first.target)
        others = [count for i, count in enumerate(learned) if i not in held]
        assert len(fold.others.known) == sum(others)


def test_windows_have_those_alone_who_interact():
    recording = crossing("zara01", rows=LONG)
    examples = stacked(list(window_examples(recording)))
    np.testing.assert_array_equal(examples.scene.bodies.there.sum(axis=1), 2)
    # Nothing of a window is later than its span.
    start, end = recording.frame_range
    part = 12 * 10 / (end - start)
    assert not list(window_examples(recording, span=(0.0, part)))
    assert 0 < len(list(window_examples(recording, span=(0.0, 0.85)))) <= len(examples.known)


def test_moments_between_steps_where_there_are_rows():
    fine = replace(
        crossing("zara01"),
        tracks=(
            walk("1", "pedestrian", range(200), (0.0, 0.0), (1.0, 0.0), 25.0),
            walk("2", "pedestrian", range(200), (0.0, 3.0), (1.0, 0.0), 25.0),
        ),
    )
    once, twice = (len(list(recorded_examples(fine, phases=p))) for p in (1, 2))
    assert 2 * once - 2 <= twice <= 2 * once
    rough = crossing("zara01")
    once, twice = (len(list(recorded_examples(rough, phases=p))) for p in (1, 2))
    assert twice == once


@pytest.mark.parametrize("true", [0.5, 0.8])
def test_share_and_deviations_by_folds(data, tmp_path, monkeypatch, true):
    """Truths are made from a network's own futures: their share is found, and their deviations."""
    examples = stacked(list(recorded_examples(crossing("zara01"), 2)))
    random = np.random.default_rng(0)
    anchors = random.normal(size=(MODES, COEFFICIENTS))
    network = ProposalNetwork(key=jax.random.key(3), anchors=anchors)

    def future(scene):
        found = joint_futures(with_share(network, true), scene, GameUse(game=False))
        path = positions(scene.frames, found.strategy[0], GAME_BASIS)
        return path, deviations(found.spread, GAME_BASIS)[0]

    path, spread = jax.vmap(future)(examples.scene)
    noise = 0.02 * spread * random.standard_normal(path.shape)
    held = examples._replace(target=np.asarray(path + noise, np.float32))
    numbers = np.arange(len(held.known)) % 2
    folds = tuple(Fold(examples, held, numbers) for _ in range(2))
    monkeypatch.setattr(hybrid, "_proposing", lambda *_: Trained(network, (), 0))
    everything = TrainingData(examples, examples, examples, examples, folds)
    share, factor = hybrid.cross_calibration(everything, tmp_path, PROPOSING, lambda _: None)
    assert share == pytest.approx(true)
    assert factor < 0.5


def test_scenes_of_eth_have_their_own_frame_rate(data):
    recording = hybrid_data._recordings(data)
    rates = {r.name: r.rate for r in recording}
    assert rates["eth"] == 15.0
    assert rates["zara01"] == 25.0


def test_who_comes_close_by_hand():
    def pair(gap):
        tracks = (
            straight(1, (0.0, 0.0), (1.0, 0.0), 25.0, rows=LONG),
            straight(2, (0.0, gap), (1.0, 0.0), 25.0, rows=LONG),
        )
        return stacked(list(recorded_examples(replace(crossing("zara01"), tracks=tracks))))

    radii = 0.5
    assert close(pair(CLOSE + radii - 0.05)).all()
    assert not close(pair(CLOSE + radii + 0.05)).any()


def test_anchors_are_in_units_of_speed():
    examples = stacked(list(recorded_examples(crossing("zara01", rows=LONG))))
    # Straight motion has no departure.
    np.testing.assert_allclose(anchors_of(examples, 0), 0.0, atol=1e-3)


def chosen_by(trainable):
    """Names of the parts that a stage changes."""
    mask = trainable(ProposalNetwork(key=jax.random.key(0)))
    return {
        jax.tree_util.keystr(path).split(".")[1].split("[")[0]
        for path, trained in jax.tree_util.tree_leaves_with_path(mask)
        if trained is True
    }


def test_what_each_stage_trains():
    assert chosen_by(traits_alone) == {"trait", "noise"}
    # Anchors are clusters of futures, the share is found by held-out recordings.
    parts = {field.name for field in fields(ProposalNetwork)}
    assert chosen_by(all_but_anchors) == parts - {"anchors", "share"}


class KilledError(Exception):
    pass


def test_an_interrupted_training_ends_with_the_same_weights(data, tmp_path):
    recording = read_scene_file(str(data / "zara01_obsmat.txt"), "zara1")
    examples = stacked(list(recorded_examples(recording, 4)))
    both = TrainingData(examples, examples, examples, examples)
    schedule = replace(PROPOSING, epochs=3, batch=8, warmup=2)
    train = partial(learn_hybrid, both, use=GameUse(game=False), proposing=schedule)
    whole = train(tmp_path / "whole")

    def kill(epoch):
        if epoch.number == 1:
            raise KilledError

    with pytest.raises(KilledError):
        train(tmp_path / "killed", on_epoch=kill)
    resumed = train(tmp_path / "killed")
    assert whole.curve == resumed.curve
    mine, theirs = (arrays_of(found.network) for found in (whole, resumed))
    for name, values in mine.items():
        np.testing.assert_array_equal(values, theirs[name])
    assert whole.curve[-1].train < whole.curve[0].train
    assert len(jax.tree.leaves(mine)) > 20
