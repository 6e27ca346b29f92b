"""Names that a reader sees: every registered agent has one, and so has anybody's own."""

import re

import pytest

from agents.registry import ALL_PREDICTORS, CROSSWALK_EGOS, DRIVING_EGOS
from evaluation.reports.naming import COLOURS, colour_of, label_of


@pytest.mark.parametrize("names", [ALL_PREDICTORS, DRIVING_EGOS, CROSSWALK_EGOS])
def test_registered_agents_have_colours_of_their_own(names):
    assert set(names) <= set(COLOURS)
    found = [colour_of(name) for name in names]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("name", ["mine.models:Net", "kalman+plan", "mine:Net+plan"])
def test_anybody_s_own_has_a_label_and_a_colour(name):
    assert label_of(name)
    assert re.fullmatch("#[0-9A-F]{6}", colour_of(name))
    assert colour_of(name) == colour_of(name)


SOURCE = """
class Net:
    name = "deep net"
    def predict(self, history, steps):
        raise NotImplementedError
"""


def test_labels_are_the_names_of_the_objects(tmp_path, monkeypatch):
    (tmp_path / "own_net.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    assert label_of("own_net:Net") == "deep net"
    assert label_of("own_net:Net+plan") == "deep net+plan"
    assert label_of("kalman+plan") == "kalman+plan"
    assert label_of("not_here:Net") == "not_here:Net"
