"""Predictions of partly observed encounters, on a recording whose discount factors are known."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.reports.partial_encounter import partial_encounter_picture
from evaluation.samples.recording import (
    COLLISION_WEIGHT,
    driven_pairs,
    made_recording,
    true_gammas,
)
from evaluation.windows.encounters import EncounterError, crossing_of
from evaluation.windows.partial_encounter import METHODS, predict_encounter, predict_encounters
from foresight_env.datasets import Recording, closest_crossings

SECONDS = 2.8
LATE = 70
"""Last observed frame of the first pair, 5 + 13 * 5."""


def predictions(recording, **rest):
    return predict_encounters(recording, SECONDS, collision_weight=COLLISION_WEIGHT, **rest)


@pytest.fixture(scope="module")
def found():
    recording = made_recording()
    return [predictions(recording, agents=pair)[0] for pair in driven_pairs()]


def test_discount_factors_are_identified(found):
    for encounter in found:
        assert encounter.estimate.gamma_identifiable.all()
        for agent, (low, high) in zip(
            encounter.agents, encounter.estimate.gamma_interval, strict=True
        ):
            assert low <= true_gammas()[agent] <= high < low + 0.2


def test_inferring_predicts_best(found):
    for encounter in found:
        errors = encounter.average_errors
        assert tuple(errors) == METHODS
        assert errors["infer-gamma"] < 0.5 * errors["constant-velocity"]
        assert errors["infer-gamma"] < 0.2 * errors["assume-gamma-1"]


def test_nothing_later_is_observed():
    """Positions after the observed seconds change nothing but the errors."""
    recording = made_recording()
    crossing = crossing_of(recording, driven_pairs()[0])
    before = predict_encounter(recording, crossing, SECONDS, COLLISION_WEIGHT)
    later = [
        replace(
            track,
            position=track.position + np.where(track.frames > LATE, 0.2, 0.0)[:, None],
            velocity=track.velocity + np.where(track.frames > LATE, 0.2, 0.0)[:, None],
        )
        for track in recording.tracks
    ]
    moved = replace(recording, tracks=tuple(later))
    after = predict_encounter(moved, crossing, SECONDS, COLLISION_WEIGHT)
    changed = before.positions != after.positions
    assert changed[before.num_observed].any()
    assert not changed[: before.num_observed].any()
    for name in METHODS:
        np.testing.assert_array_equal(before.predicted[name], after.predicted[name])
    np.testing.assert_array_equal(before.estimate.gamma, after.estimate.gamma)


def test_the_closest_crossings_come_first():
    recording = made_recording()
    (closest,) = predictions(recording, count=1)
    assert closest.agents == closest_crossings(recording)[0].agents


def test_an_agent_that_leaves(tmp_path, found):
    """Errors and the picture are of the positions that there are."""
    positions = found[0].positions.copy()
    positions[-2:, 0] = np.nan
    encounter = replace(found[0], positions=positions)
    assert all(np.isfinite(list(encounter.average_errors.values())))
    assert partial_encounter_picture(encounter, tmp_path / "it.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("seconds", "weight", "told"),
    [
        (0.0, 1.0, "observed_seconds: is 0.0; expected a positive number"),
        (2.0, np.nan, "collision_weight: is nan; expected a positive number"),
        (0.5, 1.0, r"3 positions 0\.21 s apart in the first 0\.5 s .* expected at least 6 and 4"),
        (5.8, 1.0, r"and 1 later; expected at least 6 and 4 of each agent"),
    ],
)
def test_bad_numbers(seconds, weight, told):
    with pytest.raises(ValueError, match=told):
        predict_encounters(
            made_recording(), seconds, agents=driven_pairs()[0], collision_weight=weight
        )


def test_no_crossing():
    with pytest.raises(EncounterError, match="the paths of no two agents cross"):
        predict_encounters(Recording("apart", "dut", 23.98, made_recording().tracks[:1]), SECONDS)
