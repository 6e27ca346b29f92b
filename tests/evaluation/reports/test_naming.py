"""Names that a reader sees: every registered agent has one, and so has anybody's own."""

import re

import pytest

from agents.registry import CROSSWALK_EGOS, DRIVING_EGOS, PREDICTORS
from evaluation.reports.naming import COLOURS, LABELS, colour_of, label_of


@pytest.mark.parametrize("names", [PREDICTORS, DRIVING_EGOS, CROSSWALK_EGOS])
def test_registered_agents_have_colours_of_their_own(names):
    assert set(names) <= set(COLOURS)
    found = [colour_of(name) for name in names]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("name", ["mine.models:Net", "kalman+plan", "mine:Net+plan"])
def test_anybody_s_own_has_a_label_and_a_colour(name):
    assert label_of(name)
    assert re.fullmatch("#[0-9A-F]{6}", colour_of(name))
    assert colour_of(name) == colour_of(name)


def test_an_ego_that_plans_with_a_predictor_names_it():
    assert label_of("kalman+plan") == f"{LABELS['kalman']}, planned"
    assert label_of("mine:Net") == "mine:Net"
