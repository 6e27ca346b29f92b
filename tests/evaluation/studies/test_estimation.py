"""The crosswalk's estimation study: which trajectory an estimate stands for."""

import numpy as np
import pytest

from evaluation.studies import estimation
from evaluation.studies.estimation import estimated, joint, run_sequence
from foresight_env.inverse import Posterior

SEQUENCE = 1000
"""Of development; the study's own are 0 to 49."""


@pytest.fixture
def few_samples(monkeypatch):
    monkeypatch.setitem(estimation.POSTERIOR, "positions", Posterior(8, rounds=2))


def test_from_noisy_positions_infer_gamma_is_the_mean_of_the_posterior(few_samples):
    row = run_sequence("positions", 0.1, SEQUENCE, "infer-gamma", "soft", 1)
    assert row["solved"]
    assert row["error_squared"] < row["equilibrium_error_squared"]
    baseline = run_sequence("positions", 0.1, SEQUENCE, "assume-gamma-1", "soft", 1)
    assert baseline["error_squared"] == baseline["equilibrium_error_squared"]
    assert row["solves"] > 8 > 0


def test_without_noise_it_is_the_best_fit():
    row = run_sequence("positions", 0.0, SEQUENCE, "infer-gamma", "soft", 8)
    assert row["error_squared"] == row["equilibrium_error_squared"] < 1e-4


def test_the_estimated_trajectory_is_the_mean_where_there_is_one():
    found = estimation.fit(
        "positions", 0.05, SEQUENCE, "assume-gamma-1", starts=1, posterior=Posterior()
    )
    assert found.mean is not None
    np.testing.assert_array_equal(estimated(found), np.concatenate(found.mean.states, axis=1))
    plain = found._replace(mean=None)
    np.testing.assert_array_equal(estimated(plain), joint(found.solution))
