"""Properties of every registered predictor, and exact predictions of simple ones."""

import numpy as np
import pytest

from agents import (
    PREDICTORS,
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
    EncounterPredictor,
    History,
    Predictor,
    make_predictor,
)
from agents.predictors.encounter_fit import LEAST_SPEED
from foresight_env.inverse import Estimate

DT = 0.4
KNOWN, AHEAD = 5, 4
KINDS = ("car", "pedestrian")


def turning(radius, speed, angles):
    """Places and velocities on a circle to the left about the origin."""
    places = radius * np.stack([np.sin(angles), -np.cos(angles)], axis=1)
    return places, speed * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def history(kinds=KINDS, late=0, turn=0.2, angle=0.0, shift=(0.0, 0.0)):
    """A car on a circle and somebody who walks towards it; all turned by `angle` and moved."""
    times = DT * np.arange(KNOWN)
    states = np.zeros((KNOWN, 2, 4))
    headings = np.full((KNOWN, 2), np.nan)
    speed = 4.0
    if turn:
        states[:, 0, :2], states[:, 0, 2:] = turning(speed / turn, speed, turn * times)
        headings[:, 0] = np.mod(turn * times + angle, 2.0 * np.pi)
    else:
        states[:, 0] = np.stack([speed * times, 0 * times, 0 * times + speed, 0 * times], axis=1)
        headings[:, 0] = np.mod(angle, 2.0 * np.pi)
    states[:, 1, :2] = np.array([12.0, -14.0]) + times[:, None] * np.array([0.1, 1.3])
    states[:, 1, 2:] = 0.1, 1.3
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for part in (slice(0, 2), slice(2, 4)):
        states[..., part] = states[..., part] @ turned.T
    states[..., :2] += shift
    states[:late, 0] = headings[:late, 0] = np.nan
    return History(states, headings, kinds, np.full((2, 2), np.nan), DT)


@pytest.fixture(params=PREDICTORS)
def predictor(request):
    return make_predictor(request.param)


def test_a_forecast_has_a_place_for_everybody(predictor):
    found = predictor.predict(history(late=1), AHEAD)
    assert isinstance(predictor, Predictor)
    modes = len(found.probabilities)
    assert found.positions.shape == (modes, AHEAD, 2, 2)
    assert np.isfinite(found.positions).all()
    assert found.probabilities.sum() == pytest.approx(1.0)
    assert found.most_likely.shape == (AHEAD, 2, 2)
    if found.covariance is not None:
        assert found.covariance.shape == (modes, AHEAD, 2, 2, 2)
        assert (np.linalg.eigvalsh(found.covariance) >= -1e-9).all()
    assert not found.fallback
    # The first step begins at last observed positions.
    step = np.linalg.norm(found.most_likely[0] - history().states[-1, :, :2], axis=1)
    assert (step < 2.0 * 4.0 * DT).all()


def test_forecasts_do_not_depend_on_the_axes(predictor):
    """Turned and moved, the same history has the same future, turned and moved."""
    angle, shift = 2.0, np.array([30.0, -7.0])
    plain = predictor.predict(history(), AHEAD).most_likely
    turned = predictor.predict(history(angle=angle, shift=shift), AHEAD).most_likely
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose((turned - shift) @ back.T, plain, atol=0.02)


def test_the_same_history_has_the_same_forecast(predictor):
    first, second = (predictor.predict(history(), AHEAD).positions for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_constant_velocity_by_hand():
    seen = history()
    seen.states[-1, 1] = np.nan  # last seen one step earlier
    path = ConstantVelocityPredictor().predict(seen, AHEAD).most_likely
    ahead = DT * np.arange(1, AHEAD + 1)[:, None]
    car, walker = seen.states[-1, 0], seen.states[-2, 1]
    np.testing.assert_allclose(path[:, 0], car[:2] + ahead * car[2:])
    np.testing.assert_allclose(path[:, 1], walker[:2] + (ahead + DT) * walker[2:])


def test_constant_turn_rate_stays_on_the_circle():
    path = ConstantTurnRatePredictor().predict(history(turn=0.2), AHEAD).most_likely
    angles = 0.2 * DT * (KNOWN - 1 + np.arange(1, AHEAD + 1))
    np.testing.assert_allclose(path[:, 0], turning(20.0, 4.0, angles)[0], atol=1e-9)
    straight = ConstantVelocityPredictor().predict(history(turn=0.2), AHEAD).most_likely
    np.testing.assert_allclose(path[:, 1], straight[:, 1])  # people go straight on
    assert not np.allclose(path[:, 0], straight[:, 0])


def test_the_game_keeps_to_a_circle_that_nobody_is_near():
    """Without others a vehicle continues its motion, observed late or from the beginning."""
    for late in (0, 2):
        found = EncounterPredictor().predict(history(late=late), AHEAD)
        circle = ConstantTurnRatePredictor().predict(history(late=late), AHEAD)
        np.testing.assert_allclose(found.most_likely[:, 0], circle.most_likely[:, 0], atol=0.1)


def test_gammas_are_inferred_or_one():
    free = EncounterPredictor().predict(history(), AHEAD)
    fixed = EncounterPredictor(infer=False).predict(history(), AHEAD)
    assert ((free.gamma >= 0.0) & (free.gamma <= 1.0)).all()
    np.testing.assert_array_equal(fixed.gamma, [1.0, 1.0])
    np.testing.assert_array_equal(fixed.gamma_deviation, [0.0, 0.0])
    assert fixed.gamma_identifiable.all()
    # No agent is near, so that the data have no information and the prior remains.
    np.testing.assert_allclose(free.gamma, [0.7, 1.0], atol=0.1)


def test_a_fit_that_explains_nothing_is_a_fallback(monkeypatch):
    fit = EncounterPredictor.fit

    def lost(self, *arguments) -> Estimate:
        return fit(self, *arguments)._replace(cost=np.asarray(1e6))

    monkeypatch.setattr(EncounterPredictor, "fit", lost)
    found = EncounterPredictor().predict(history(), AHEAD)
    straight = ConstantVelocityPredictor().predict(history(), AHEAD)
    assert found.fallback
    np.testing.assert_array_equal(found.positions, straight.positions)


def test_a_standing_vehicle_does_not_turn():
    standing = history(turn=0.0)
    standing.states[:, 0, 2:] = 0.1 * LEAST_SPEED, 0.0
    standing.headings[:, 0] = np.linspace(0.0, 3.0, KNOWN)  # what a tracker says of parked cars
    path = ConstantTurnRatePredictor().predict(standing, AHEAD).most_likely[:, 0]
    np.testing.assert_allclose(path[:, 1], standing.states[-1, 0, 1], atol=1e-12)


def test_wrong_histories_and_names():
    good = history()
    for change, told in (
        ({"kinds": ("car",)}, r"states: has shape \(5, 2, 4\); expected \(5, 1, 4\) for 1 kinds"),
        ({"kinds": ("car", "Pedestrian")}, r"kinds\[1\]: is 'Pedestrian'; expected \"pedestrian\""),
        ({"kinds": ("cyclist", "car")}, r"kinds\[0\]: is 'cyclist'; expected \"bicycle\""),
        ({"dt": 0.0}, "dt: is 0.0"),
        ({"states": np.full((KNOWN, 2, 4), np.nan)}, "agent 0 was never seen"),
    ):
        parts = {name: getattr(good, name) for name in History.__dataclass_fields__}
        with pytest.raises(ValueError, match=told):
            History(**{**parts, **change})
    with pytest.raises(ValueError, match="predictor: 'magic' is unknown; choose from hybrid-game"):
        make_predictor("magic")
