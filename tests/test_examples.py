"""The examples run and find what they claim to find."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from evaluation.studies.eth_ucy import study
from evaluation.training.export import export_recordings
from tests.support.made_scenes import write_scenes

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def example(name):
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def test_own_game(capsys):
    true, inferred = example("own_game")["main"]()
    np.testing.assert_allclose(inferred, true, atol=0.1)
    told = capsys.readouterr().out
    assert "local equilibrium: True" in told
    assert "solved 100.0% of 1000" in told


def test_online():
    state, _ = example("online")["main"](steps=8)
    assert state.failures == 0
    assert state.estimate is not None
    assert 0.0 <= state.gamma[1] <= 1.5
    assert state.gamma_deviation[1] < 1.0


def test_the_library_s_ego_beats_the_rule_of_thumb():
    made = example("step_loop")
    assert made["by_ego"]() > made["by_hand"]()


def test_a_plain_function_predicts():
    errors = example("own_predictor")["main"](episodes=2)
    assert set(errors) == {"slowing", "constant-velocity", "kalman"}
    assert all(0.0 < error < 2.0 for error in errors.values())


def test_a_network_enters_the_protocol(tmp_path, monkeypatch):
    """Exported, trained without each scene, evaluated with the weights of the scene."""
    data = write_scenes(tmp_path / "data")
    tensors = export_recordings(data, tmp_path / "tensors")
    monkeypatch.syspath_prepend(EXAMPLES)
    example("own_jax_predictor")["main"](tmp_path / "tensors", tmp_path / "weights", rounds=100)
    name = "own_jax_predictor:OwnMlp"
    rows = study(tmp_path / "out", data, (name,), weights=tmp_path / "weights", workers=0)
    assert not any(row["error"] for row in rows)
    assert len({row["scene"] for row in rows}) == len(np.unique(tensors.scene)) == 5
    # They walk straight on, which a new network is wrong about.
    untrained = study(tmp_path / "out", data, (name,), workers=0)
    errors = [np.mean([e for row in part for e in row["ade"]]) for part in (rows, untrained)]
    assert errors[0] < 0.5 * errors[1]
    with pytest.raises(FileNotFoundError, match="own-mlp"):
        study(tmp_path / "new", data, (name,), weights=tmp_path / "none", workers=0)


def test_many_environments_are_stepped_together():
    returns = example("many_at_once")["main"](modes=("sync", "vector_entry_point"))
    np.testing.assert_allclose(returns["sync"], returns["vector_entry_point"], rtol=1e-4)


def test_wrappers(tmp_path):
    made = example("wrappers")
    assert made["film"](tmp_path / "film", steps=4).stat().st_size > 1000
    shape, earned = made["stacked"](steps=3)
    assert shape == (4, 6)
    assert earned < 0.0
    earned = made["agent_by_agent"](steps=3)
    assert set(earned) == {"car_0", "car_1"}
    assert all(value < 0.0 for value in earned.values())


@pytest.mark.rl
def test_stable_baselines_trains():
    pytest.importorskip("stable_baselines3")
    before, after = example("train_sb3")["main"](steps=256, judged=2)
    assert np.isfinite([before, after]).all()
    assert before != after  # 256 steps change the policy; better they do not make it


# TorchRL 0.14 warns of what it calls itself, and of what it finds optional.
@pytest.mark.filterwarnings("default")
@pytest.mark.rl
def test_everybody_learns_with_torchrl():
    pytest.importorskip("torchrl")
    returns = example("train_torchrl")["main"](batches=1, frames=200)
    assert len(returns) == 1
    assert np.isfinite(returns).all()


@pytest.mark.rl
def test_a_pytorch_model_predicts():
    pytest.importorskip("torch")
    losses = example("own_torch_predictor")["main"]()
    assert losses[-1] < 0.5 * losses[0]
