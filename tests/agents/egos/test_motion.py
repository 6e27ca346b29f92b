"""Straight, even motion from a few observations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.egos.motion import (
    FIT_STEPS,
    extrapolate,
    fit_constant_velocity,
    player_positions,
    present_state,
)
from foresight_env.envs.core.scene import own_first
from foresight_env.games import DoubleIntegrator, ObservationModel, SlipBicycle
from foresight_env.scenarios.crosswalk import crosswalk_game

NAN = np.nan
WALKER, CAR = DoubleIntegrator(0.5), SlipBicycle(0.5)
SMALL = st.floats(-5.0, 5.0)


def test_least_squares_by_hand():
    """Points 0, 1, 1 one second apart: slope 1/2, and 2/3 + 1/2 at the last of them."""
    track = np.array([[0.0, 5.0], [1.0, 5.0], [1.0, 5.0]])
    position, velocity = fit_constant_velocity(track, 1.0)
    np.testing.assert_allclose(position, [7.0 / 6.0, 5.0])
    np.testing.assert_allclose(velocity, [0.5, 0.0], atol=1e-12)


def test_one_observation_means_rest():
    position, velocity = fit_constant_velocity(np.array([[NAN, NAN], [3.0, 4.0]]), 0.1)
    assert position.tolist() == [3.0, 4.0]
    assert velocity.tolist() == [0.0, 0.0]


def test_the_present_is_the_last_row_even_where_it_is_missing():
    track = np.array([[0.0, 0.0], [1.0, 2.0], [NAN, NAN], [NAN, 3.0]])
    position, velocity = fit_constant_velocity(track, 0.5)
    np.testing.assert_allclose(velocity, [2.0, 4.0])
    np.testing.assert_allclose(position, [3.0, 6.0])


def test_old_observations_are_forgotten():
    track = np.zeros((FIT_STEPS + 3, 2))
    track[:3] = 1e6
    position, velocity = fit_constant_velocity(track, 0.1)
    np.testing.assert_allclose([*position, *velocity], 0.0, atol=1e-9)


def test_never_seen():
    with pytest.raises(ValueError, match="track: the agent was never seen"):
        fit_constant_velocity(np.full((3, 2), NAN), 0.1)


@given(st.tuples(SMALL, SMALL), st.tuples(SMALL, SMALL), st.integers(2, 8), st.floats(0.05, 1.0))
def test_straight_motion_is_found_and_continued(position, velocity, count, dt):
    times = dt * np.arange(-count + 1, 1)[:, None]
    track = np.array(position) + times * np.array(velocity)
    found = fit_constant_velocity(track, dt)
    np.testing.assert_allclose(found[0], position, atol=1e-9)
    np.testing.assert_allclose(found[1], velocity, atol=1e-8)
    ahead = extrapolate(WALKER, np.concatenate(found), 3, dt)
    end = np.array(position) + 3 * dt * np.array(velocity)
    np.testing.assert_allclose(ahead[2, :2], end, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(ahead[:, 2:], np.tile(velocity, (3, 1)), atol=1e-8)


def test_extrapolation_by_hand():
    ahead = extrapolate(WALKER, np.array([1.0, 2.0, 1.0, -2.0]), 2, 0.5)
    np.testing.assert_allclose(ahead, [[1.5, 1.0, 1.0, -2.0], [2.0, 0.0, 1.0, -2.0]])
    turn = np.pi / 2.0  # upwards at 2 m/s
    ahead = extrapolate(CAR, np.array([1.0, 2.0, 2.0, turn]), 2, 0.5)
    np.testing.assert_allclose(ahead, [[1.0, 3.0, 2.0, turn], [1.0, 4.0, 2.0, turn]], atol=1e-12)


@pytest.mark.parametrize("width", [2, 4])
def test_the_present_state_of_a_car(width):
    """Westwards at 3 m/s, seen with a heading that has gone round once, or by positions alone."""
    heading = 3.0 * np.pi
    rows = np.array([[6.0 - 0.3 * k, 1.0, 3.0, heading] for k in range(4)])[:, :width]
    model = ObservationModel(lambda states: states, (0,) * width)
    found = present_state(CAR, model, rows, 0, 0.1)
    expected = heading if width == 4 else np.pi
    np.testing.assert_allclose(found[:3], [5.1, 1.0, 3.0], atol=1e-9)
    assert np.mod(found[3] - expected + np.pi, 2.0 * np.pi) == pytest.approx(np.pi, abs=1e-9)
    if width == 4:
        assert found[3] == pytest.approx(heading)
        np.testing.assert_array_equal(present_state(CAR, model, rows[:1], 0, 0.1), rows[0])
    else:
        np.testing.assert_array_equal(
            present_state(CAR, model, rows[:1], 0, 0.1), [6.0, 1.0, 0.0, 0.0]
        )


def test_a_standing_car_keeps_its_heading():
    rows = np.array([[6.0, 1.0, 0.0, 2.0], [6.0, 1.001, 0.0, 2.0]])
    model = ObservationModel(lambda states: states, (0,) * 4)
    assert present_state(CAR, model, rows, 0, 0.1)[3] == 2.0


@pytest.mark.parametrize("observation", ["full", "positions"])
def test_positions_belong_to_their_player(observation):
    """Agent 2 of 3 sees itself first, then 0, then 1."""
    model = own_first(observation, crosswalk_game(3, 4), 2)
    width = model.size // 3
    row = np.repeat([2.0, 0.0, 1.0], width)
    row[1::width] += 0.5
    for player in range(3):
        seen = player_positions(model, row[None], player)
        assert seen.tolist() == [[player, player + 0.5]]
