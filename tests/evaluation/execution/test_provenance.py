"""Rows of an agent are not taken for those of another of the same name."""

import json
import sys
from dataclasses import replace

import pytest

from agents.registry import ALL_PREDICTORS, DRIVING_EGOS, make_ego, make_predictor
from evaluation.execution.provenance import fingerprint


@pytest.mark.parametrize("name", ALL_PREDICTORS)
def test_settings_are_in_it(name):
    found = fingerprint(make_predictor(name))
    assert found == fingerprint(make_predictor(name))
    assert "source" not in json.loads(found)


def test_egos_differ_by_their_settings_and_their_predictor():
    found = {fingerprint(make_ego(name)) for name in [*DRIVING_EGOS, "kalman+plan", "orca+plan"]}
    assert len(found) == len(DRIVING_EGOS) + 2
    ego = make_ego("kalman+plan")
    assert fingerprint(replace(ego, risk=0.2)) != fingerprint(ego)


OWN = """
class Straight:
    name = "straight"
    def predict(self, history, steps):
        return {}
"""


def test_a_user_s_source_is_in_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    found = []
    for said in ("history", "steps"):
        (tmp_path / "own_model.py").write_text(OWN.format(said))
        found.append(fingerprint(make_predictor("own_model:Straight")))
        found.append(fingerprint(make_ego("own_model:Straight+plan")))
        del sys.modules["own_model"]
    assert len(set(found)) == 4
