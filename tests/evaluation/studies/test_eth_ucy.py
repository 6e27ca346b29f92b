"""The ETH/UCY protocol on generated scenes with known answers."""

import json

import numpy as np
import pytest

from agents import Forecast
from agents.predictors.sampled_velocity import SampledVelocityPredictor, directions
from evaluation.studies import eth_ucy
from evaluation.studies.eth_ucy import judged_agents, study
from evaluation.windows.complete import PREDICTED, histories_at
from evaluation.windows.eth_ucy import SCENES
from tests.support.made_scenes import crossing, turning, write_scenes

SIMPLE = ("constant-velocity", "kalman")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scenes(tmp_path_factory.mktemp("scenes"))


def test_people_who_walk_straight_are_predicted_exactly(tmp_path, data, monkeypatch):
    rows = study(tmp_path, data, SIMPLE, workers=0)
    assert len(rows) == 3 * len(SCENES) * len(SIMPLE)
    assert not any(row["error"] for row in rows)
    for row in rows:
        assert row["agents"] == ["1", "2", "3"]
        assert len(row["seconds"]) == 2  # histories
        assert max(row["missed"]) == row["fallbacks"] == 0
        # They pass 0.6 m from each other, as recorded.
        assert row["overlaps"] == row["overlaps_recorded"]
        if row["predictor"] == "constant-velocity":
            for name in ("ade", "fde", "best_ade", "best_fde"):
                np.testing.assert_allclose(row[name], 0.0, atol=1e-9)
            assert row["nll"] is row["levels"] is None
        else:
            assert len(row["nll"]) == 3
            assert sum(row["levels"]) == 3 * PREDICTED
            assert row["levels"][0] > 20  # far too cautious for such people

    def not_again(*arguments, **more):
        raise AssertionError("a window that has a row was run again")

    monkeypatch.setattr(eth_ucy, "run_window", not_again)
    assert study(tmp_path, data, SIMPLE, workers=0) == rows
    # Every second of three windows in each scene.
    assert len(study(tmp_path, data, SIMPLE[:1], every=2, workers=0)) == 2 * len(SCENES)


def test_a_turn_that_one_of_20_directions_has():
    """A person turns now by the angle of a quantile: minADE is 0, the straight future is not."""
    angle = float(directions(np.deg2rad(25.0))[5])
    made = turning(crossing("made"), step=7, angle=angle)
    window = next(iter(histories_at(made, 70, ("1", "2", "3"))))
    found = judged_agents(window, SampledVelocityPredictor().predict(window.history, PREDICTED))
    assert found["agents"] == ["1", "2"]
    assert found["best_ade"][0] == pytest.approx(0.0, abs=1e-9)
    assert found["best_fde"][0] == pytest.approx(0.0, abs=1e-9)
    # Chord of the angle at 12 steps of 0.4 m.
    assert found["fde"][0] == pytest.approx(2.0 * 4.8 * np.sin(0.5 * abs(angle)))
    assert found["ade"][0] == pytest.approx(found["fde"][0] * 6.5 / 12.0)
    np.testing.assert_allclose([found["ade"][1], found["best_ade"][1]], 0.0, atol=1e-9)


def test_only_the_most_probable_20_futures_count():
    made = crossing("made")
    window = next(iter(histories_at(made, 70, ("1", "2", "3"))))
    wrong = np.repeat(np.nan_to_num(window.truth)[None] + 5.0, 21, axis=0)
    wrong[20] -= 5.0
    forecast = Forecast(wrong, np.array([0.048] * 20 + [0.04]))
    assert judged_agents(window, forecast)["best_ade"] == pytest.approx([50.0**0.5] * 2)
    forecast = Forecast(wrong, np.array([0.047] * 20 + [0.06]))
    found = judged_agents(window, forecast)
    assert found["best_ade"] == found["ade"] == [0.0, 0.0]
    assert found["missed"] == [0, 0]


def test_bad_requests(tmp_path, data):
    for more, told in (
        ({"scenes": ("zara3",)}, "scenes: 'zara3' is unknown; choose from eth"),
        ({"predictors": ("magic",)}, "predictor: 'magic' is unknown"),
        ({"data": tmp_path}, "has no eth_obsmat.txt"),
    ):
        arguments = {"data": data, "predictors": SIMPLE, **more}
        with pytest.raises(ValueError, match=told):
            study(tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


def test_learned_predictors_need_weights_of_each_fold(tmp_path, data):
    with pytest.raises(
        ValueError, match=r"eth/social-lstm.safetensors: is missing; .*foresight train social-lstm"
    ):
        study(tmp_path / "out", data, ("social-lstm",), weights=tmp_path)
    assert not (tmp_path / "out").exists()


OWN = """
from pathlib import Path
import numpy as np
from agents import Forecast

class Shifted:
    name = "shifted"
    def __init__(self, weights=None):
        self.shift = 0.0 if weights is None else float((Path(weights) / "shifted.txt").read_text())
    def predict(self, history, steps):
        times = history.dt * np.arange(1, steps + 1)[:, None, None]
        now = history.states[-1]
        return Forecast((now[:, :2] + times * now[:, 2:] + [self.shift, 0.0])[None], np.ones(1))
"""


def test_your_own_class_gets_the_weights_of_the_scene(tmp_path, data, monkeypatch):
    (tmp_path / "shifted_model.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    for k, scene in enumerate(SCENES):
        (tmp_path / "weights" / scene).mkdir(parents=True)
        (tmp_path / "weights" / scene / "shifted.txt").write_text(str(k))
    arguments = tmp_path / "out", data, ("shifted_model:Shifted",)
    rows = study(*arguments, weights=tmp_path / "weights", workers=0)
    assert not any(row["error"] for row in rows)
    for k, scene in enumerate(SCENES):
        own = [error for row in rows if row["scene"] == scene for error in row["ade"]]
        np.testing.assert_allclose(own, k, atol=1e-9)
    assert json.loads(rows[0]["settings"])["weights"].keys() == SCENES.keys()
    # Other weights are another predictor.
    (tmp_path / "weights" / "eth" / "shifted.txt").write_text("7")
    again = study(*arguments, weights=tmp_path / "weights", workers=0)
    assert {row["settings"] for row in again}.isdisjoint({row["settings"] for row in rows})
    eth = [error for row in again if row["scene"] == "eth" for error in row["ade"]]
    np.testing.assert_allclose(eth, 7.0, atol=1e-9)
