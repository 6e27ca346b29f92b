"""Recorded encounters, on the recording that the project makes itself."""

from functools import lru_cache

import numpy as np
import pytest

from evaluation.metrics import displacement
from evaluation.recorded import (
    METHODS,
    OBSERVED,
    PREDICTED,
    EncounterError,
    aging_covariance,
    constant_velocity,
    encounters,
    forecast,
)
from evaluation.sample import PAIRS, made_recording, write_sample
from foresight_env.datasets import RecordingError, open_recording


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample"))


@lru_cache
def cuts(path):
    return encounters(path, count=None)


def test_the_sample_is_a_recording(sample):
    found = open_recording(sample)
    assert set(found.agents) == {f"ped:{k}" for k in range(2 * len(PAIRS))}
    made = made_recording()
    for track in made.tracks:
        read = found.track(track.agent_id)
        assert len(read.frames) == len(track.frames)


def test_every_pair_of_the_sample_is_an_encounter(sample):
    pairs = {frozenset(e.interaction.agents) for e in cuts(sample)}
    assert pairs == {frozenset((f"ped:{2 * k}", f"ped:{2 * k + 1}")) for k in range(len(PAIRS))}
    assert len(encounters(sample, count=1)) == 1
    for e in cuts(sample):
        assert e.observed.shape == (OBSERVED, 2, 4)
        assert e.truth.shape == (PREDICTED, 2, 4)
        assert e.present.all()
        assert e.dt == pytest.approx(0.4, abs=0.03)
        # What is predicted follows what was observed without a gap.
        step = np.linalg.norm(e.truth[0, :, :2] - e.observed[-1, :, :2], axis=1)
        assert (step < 2.0 * e.dt).all()
        assert (step > 0.2 * e.dt).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", range(len(PAIRS)))
def test_forecasts(sample, method, number):
    encounter = cuts(sample)[number]
    found = forecast(encounter, method)
    assert found.method == method
    assert found.agents == encounter.interaction.agents
    assert found.predicted.shape == (PREDICTED, 2, 2)
    assert found.solved
    told = displacement(found.predicted, encounter.truth[..., :2], encounter.present)
    assert (found.average_error, found.final_error) == told
    # People walk 5 m in that time; a sensible prediction is off by a tenth of that.
    assert found.average_error < 0.5
    assert found.final_error < 1.0
    if method == "constant velocity":
        assert found.gamma is None
    else:
        assert ((found.gamma >= 0.0) & (found.gamma <= 1.5)).all()
        fixed = method == "farsighted"
        assert (found.gamma == 1.0).all() == fixed
        assert (found.gamma_deviation == 0.0).all() == fixed


def test_constant_velocity_by_hand(sample):
    encounter = cuts(sample)[0]
    seen = encounter.observed.copy()
    seen[-1, 1] = np.nan  # last seen one step earlier
    path = constant_velocity(encounter.__class__(**{**encounter.__dict__, "observed": seen}))
    dt = encounter.dt
    np.testing.assert_allclose(path[0, 0], seen[-1, 0, :2] + dt * seen[-1, 0, 2:])
    np.testing.assert_allclose(path[0, 1], seen[-2, 1, :2] + 2 * dt * seen[-2, 1, 2:])
    np.testing.assert_allclose(np.diff(path[:, 1], axis=0), np.tile(dt * seen[-2, 1, 2:], (9, 1)))


def test_old_observations_say_less():
    covariance = aging_covariance(0.1, 3)
    assert covariance.shape == (OBSERVED, 3, 3)
    np.testing.assert_allclose(covariance[-1], 0.01 * np.eye(3))
    assert (np.diff(covariance[:, 0, 0]) < 0.0).all()


def test_wrong_requests(sample, tmp_path):
    for ids, told in (
        (("ped:0",), "ids: 1 given; an encounter has two agents"),
        (("ped:0", "ped:9"), "has no agent 'ped:9'; it has ped:0, ped:1"),
        (("ped:0", "ped:3"), "ids: "),  # they never cross
    ):
        with pytest.raises(EncounterError, match=told):
            encounters(sample, agents=ids)
    with pytest.raises(ValueError, match="method: is 'magic'; expected one of foresight"):
        forecast(cuts(sample)[0], "magic")
    with pytest.raises(RecordingError, match="there is no such file"):
        encounters(tmp_path / "nothing.txt")
    junk = tmp_path / "junk.txt"
    junk.write_text("once upon a time\n")
    with pytest.raises(RecordingError, match="not recognised"):
        encounters(junk)
