"""Constant velocity in several directions."""

import numpy as np
import pytest
from scipy.stats import norm

from agents import ConstantVelocityPredictor, make_predictor
from agents.conformance import histories
from agents.predictors.sampled_velocity import FUTURES, directions


def test_directions_are_quantiles():
    angles = directions(np.deg2rad(25.0))
    assert len(angles) == FUTURES - 1
    assert angles[0] == 0.0
    assert (np.diff(np.abs(angles)) >= -1e-12).all()
    shares = norm.cdf(np.rad2deg(np.sort(angles)) / 25.0)
    np.testing.assert_allclose(shares, np.arange(1, FUTURES) / FUTURES)


@pytest.mark.parametrize("history", [h for _, h in histories()], ids=[n for n, _ in histories()])
def test_futures_are_straight_motion_turned(history):
    found = make_predictor("constant-velocity-sampled").predict(history, 5)
    straight = ConstantVelocityPredictor().predict(history, 5).most_likely
    np.testing.assert_array_equal(found.most_likely, straight)
    assert found.probabilities.sum() == pytest.approx(1.0)
    assert found.probabilities[0] > found.probabilities[1:].max()
    last = np.stack([history.states[history.seen(i)[-1], i, :2] for i in range(len(history.kinds))])
    way, other = straight - last, found.positions - last
    lengths = np.linalg.norm(other, axis=-1)
    np.testing.assert_allclose(lengths, np.tile(np.linalg.norm(way, axis=-1), (len(lengths), 1, 1)))
    cross = way[..., 0] * other[..., 1] - way[..., 1] * other[..., 0]
    along = np.sum(way * other, axis=-1)
    moving = np.linalg.norm(way, axis=-1) > 1e-6
    angles = np.arctan2(cross, along)
    expected = np.broadcast_to(directions(np.deg2rad(25.0))[:, None, None], angles.shape)
    np.testing.assert_allclose(angles[:, moving], expected[:, moving], atol=1e-9)
