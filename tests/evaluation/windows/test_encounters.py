"""Recorded encounters, on the recording that the project makes itself."""

from functools import lru_cache

import numpy as np
import pytest

from evaluation.metrics.trajectory import displacement
from evaluation.samples.recording import driven_pairs, made_recording, true_gammas, write_sample
from evaluation.windows.encounters import PREDICTORS, EncounterError, encounters, forecast
from evaluation.windows.interaction import Grid
from foresight_env.datasets import open_recording


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample"))


@lru_cache
def cuts(path):
    return encounters(open_recording(path), count=None)


def test_the_sample_is_a_recording(sample):
    found = open_recording(sample)
    assert set(found.agents) == set(true_gammas())
    assert set(found.agents) == {"ped:0", "ped:1", "ped:2", "ped:3", "veh:0", "veh:1"}
    made = made_recording()
    for track in made.tracks:
        read = found.track(track.agent_id)
        assert len(read.frames) == len(track.frames)


def test_every_pair_of_the_sample_is_an_encounter(sample):
    pairs = {frozenset(e.window.agents) for e in cuts(sample)}
    assert pairs == {frozenset({"ped:0", "ped:1"}), *map(frozenset, driven_pairs())}
    assert len(encounters(open_recording(sample), count=1)) == 1
    grid = Grid.of(open_recording(sample))
    for e in cuts(sample):
        window = e.window
        assert window.history.states.shape == (grid.observed, 2, 4)
        assert window.truth.shape == (grid.predicted, 2, 2)
        assert window.present.all()
        assert window.history.dt == pytest.approx(0.4, abs=0.03)
        # What is predicted follows what was observed without a gap.
        step = np.linalg.norm(window.truth[0] - window.history.states[-1, :, :2], axis=1)
        speed = np.linalg.norm(window.history.states[-1, :, 2:], axis=1)
        np.testing.assert_allclose(step, speed * window.history.dt, rtol=0.25)


@pytest.mark.parametrize("predictor", PREDICTORS)
@pytest.mark.parametrize("number", range(3))
def test_forecasts(sample, predictor, number):
    encounter = cuts(sample)[number]
    window = encounter.window
    found = forecast(encounter, predictor)
    assert found.predictor == predictor
    assert not found.forecast.fallback
    told = displacement(found.forecast.most_likely, window.truth, window.present)
    assert (found.average_error, found.final_error) == told
    # People walk 5 m in that time, the car drives 15 m; a sensible prediction is off by less.
    limit = 2.0 if {"veh:0", "veh:1"} & set(window.agents) else 0.5
    assert found.average_error < limit
    gamma = found.forecast.gamma
    assert (gamma is None) == (predictor == "constant-velocity")
    if gamma is not None:
        assert (gamma == 1.0).all() == (predictor == "encounter-game-gamma-1")


def test_wrong_requests(sample):
    for ids, told in (
        (("ped:0",), "ids: 1 given; an encounter has two agents"),
        (("ped:0", "ped:9"), "has no agent 'ped:9'; it has ped:0, ped:1"),
        (("ped:0", "ped:2"), "ids: "),  # they never cross
    ):
        with pytest.raises(EncounterError, match=told):
            encounters(open_recording(sample), agents=ids)
    with pytest.raises(
        ValueError, match=r"predictor: 'magic' is unknown; choose from .*encounter-game"
    ):
        forecast(cuts(sample)[0], "magic")
