"""The junction game as a predictor: what a car is doing now, routes, discount factors."""

import numpy as np
import pytest

from agents import Context, History, make_predictor
from agents.predictors.junction import JunctionPredictor, RealisticBelief
from agents.predictors.kinematic import ConstantVelocityPredictor

DT, KNOWN, STEPS = 0.4, 6, 5


def driven(acceleration=0.0, curvature=0.0, speed=5.0, context=Context()):
    """A car on an arc whose speed changes evenly, and a person far away."""
    times = DT * np.arange(KNOWN)
    fine = np.linspace(0.0, times[-1], 2001)
    along = speed * fine + 0.5 * acceleration * fine**2
    heading = curvature * along
    pace = speed + acceleration * fine
    places = np.stack(
        [
            np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(fine))])
            for v in (pace * np.cos(heading), pace * np.sin(heading))
        ],
        axis=1,
    )
    at = np.round(times / times[-1] * 2000).astype(int)
    states = np.zeros((KNOWN, 2, 4))
    states[:, 0, :2] = places[at]
    states[:, 0, 2:] = (pace[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1))[at]
    states[:, 1] = [40.0, 60.0, 1.0, 0.0]
    states[:, 1, 0] += times
    headings = np.full((KNOWN, 2), np.nan)
    headings[:, 0] = heading[at]
    kinds = ("car", "pedestrian")
    return History(states, headings, kinds, np.full((2, 2), np.nan), DT, context)


def forecast(history):
    found = JunctionPredictor().predict(history, STEPS)
    assert not found.fallback
    return found


def test_a_car_that_brakes_goes_less_far_than_at_constant_velocity():
    """And one that accelerates farther: by most of what the acceleration makes in two seconds."""
    ahead = DT * STEPS
    for acceleration in (-1.0, 1.0):
        history = driven(acceleration)
        path = forecast(history).most_likely[:, 0]
        straight = ConstantVelocityPredictor().predict(history, STEPS).most_likely[:, 0]
        gained = (path[-1, 0] - straight[-1, 0]) / (0.5 * acceleration * ahead**2)
        assert 0.5 < gained < 1.3


def test_forecasts_begin_where_agents_were_seen_last():
    """A last observation that is off sideways moves the whole forecast of the fit."""
    history = driven()
    history.states[-1, 0, 1] += 0.3
    path = forecast(history).most_likely[:, 0]
    fitted = np.asarray(JunctionPredictor().fit(history, STEPS).solution.states[0])[:, :2]
    off = history.states[-1, 0, :2] - fitted[KNOWN - 1]
    assert off[1] > 0.02  # the fit is a compromise with the observations before
    np.testing.assert_allclose(path, fitted[KNOWN:] + off, atol=1e-9)


def test_a_car_stays_on_its_arc():
    history = driven(curvature=0.05)
    path = forecast(history).most_likely[:, 0]
    middle = np.array([0.0, 20.0])
    np.testing.assert_allclose(np.linalg.norm(path - middle, axis=1), 20.0, atol=0.3)


def test_discount_factors_are_away_from_zero_and_certain_only_as_the_belief():
    """A car alone on the road shows no foresight: the estimate is the prior."""
    found = forecast(driven())
    belief = RealisticBelief()
    np.testing.assert_allclose(
        found.gamma, [belief.driving_gamma[0], belief.walking_gamma[0]], atol=0.15
    )
    assert not found.gamma_identifiable.any()
    fixed = make_predictor("junction-game-gamma-1").predict(driven(), STEPS)
    np.testing.assert_array_equal(fixed.gamma, [1.0, 1.0])


@pytest.fixture(scope="module")
def bend():
    """Straight on for 20 m from the origin, then to the left on a circle of 12 m."""
    along = np.arange(0.0, 50.0)
    turned = np.maximum(along - 20.0, 0.0) / 12.0
    x = np.minimum(along, 20.0) + 12.0 * np.sin(turned)
    y = 12.0 * (1.0 - np.cos(turned))
    return np.stack([x, y, turned, np.where(along > 20.0, 1.0 / 12.0, 0.0)], axis=1)


def test_a_car_follows_a_known_route(bend):
    """It has driven straight on, and turns where the others did."""
    history = driven(speed=6.0, context=Context((bend,), np.array([3.0])))
    car = forecast(history).most_likely[:, 0]
    assert history.states[-1, 0, 0] < 20.0 - 6.0 * DT
    distance = [np.min(np.hypot(*(bend[:, :2] - place).T)) for place in car]
    assert max(distance) < 1.2
    unknown = forecast(driven(speed=6.0)).most_likely[:, 0]
    assert abs(unknown[-1, 1]) < 0.2 < car[-1, 1]


def test_a_route_that_leads_elsewhere_does_not_count(bend):
    away = bend + np.array([0.0, 10.0, 0.0, 0.0])
    history = driven(context=Context((away,), np.array([3.0])))
    path = forecast(history).most_likely
    np.testing.assert_array_equal(path, forecast(driven()).most_likely)


def test_a_context_that_does_not_fit_is_refused(bend):
    with pytest.raises(ValueError, match=r"frequencies: has shape \(2,\); expected one per route"):
        Context((bend,), np.ones(2))
    with pytest.raises(ValueError, match=r"routes\[0\]: has shape \(50, 3\)"):
        Context((bend[:, :3],), np.ones(1))
