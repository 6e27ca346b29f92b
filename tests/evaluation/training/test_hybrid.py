"""Training of `hybrid-game`: what it learns from, and that an interruption changes nothing."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

from agents.hybrid.futures import GameUse
from agents.hybrid.network import ProposalNetwork
from agents.learned.weights import arrays_of
from evaluation.training import hybrid_data
from evaluation.training.hybrid import (
    PROPOSING,
    TrainingData,
    anchors_of,
    learn_hybrid,
    traits_alone,
)
from evaluation.training.hybrid_data import CLOSE, PARTS, close, leave_one_out, recorded
from evaluation.training.hybrid_examples import recorded_examples, stacked
from evaluation.windows.eth_ucy import read_scene_file
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
    made = [list(recorded_examples(r)) for r in hybrid_data._recordings(data)[:4]]
    folds = list(hybrid_data._folds(made))
    assert len(folds) == hybrid_data.FOLDS
    sizes = [len(examples) for examples in made]
    for k, fold in enumerate(folds):
        held = sizes[k :: hybrid_data.FOLDS]
        assert [int(np.sum(fold.recording == n)) for n in range(len(held))] == held
        assert len(fold.others.known) + len(fold.held.known) == sum(sizes)
    first = folds[0]
    np.testing.assert_array_equal(first.held.target[0], made[0][0].target)
    np.testing.assert_array_equal(first.held.target[first.recording == 1][0], made[3][0].target)
    monkeypatch.setattr(hybrid_data, "LONG", 1.0)  # parts are of every recording
    assert len(recorded(data).folds) == hybrid_data.FOLDS


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


def test_the_second_stage_trains_traits_alone():
    network = ProposalNetwork(key=jax.random.key(0))
    mask = traits_alone(network)
    chosen = {
        name.split(".")[1].split("[")[0]
        for name, trained in (
            (jax.tree_util.keystr(path), leaf)
            for path, leaf in jax.tree_util.tree_leaves_with_path(mask)
        )
        if trained is True
    }
    assert chosen == {"trait", "noise"}


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
