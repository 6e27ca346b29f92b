"""Windows as an observer has them: velocities from past positions."""

import numpy as np
import pytest

from evaluation.windows.interaction import Grid, cut
from foresight_env.datasets import Recording, Track, observed_window, past_velocities

RATE, STEP, ROWS = 25.0, 10, 20


def recording(positions, source="ucy", heading=np.nan):
    """One walker whose recorded velocities are central differences: they know the next position."""
    frames = STEP * np.arange(len(positions))
    velocity = np.gradient(positions, STEP / RATE, axis=0)
    track = Track("1", "pedestrian", frames, positions, velocity, np.full(len(frames), heading))
    return Recording("made", source, RATE, (track,))


def walked(seed=0):
    return np.cumsum(np.random.default_rng(seed).normal(size=(ROWS, 2)), axis=0)


@pytest.mark.parametrize("row", [3, 9, 15])
def test_a_history_does_not_change_when_later_positions_do(row):
    positions, frame = walked(), STEP * row
    changed = positions.copy()
    changed[row + 1 :] += 5.0
    first, second = (cut(recording(p), ("1",), frame) for p in (positions, changed))
    # The recorded velocity does change, so the test can fail.
    recorded = [recording(p).track("1").velocity[row] for p in (positions, changed)]
    assert np.abs(recorded[0] - recorded[1]).max() > 1.0
    np.testing.assert_array_equal(first.history.states, second.history.states)
    assert np.abs(first.truth - second.truth)[first.present].max() == pytest.approx(5.0)


def test_velocities_lead_from_the_row_before():
    positions, row = walked(), 9
    states = cut(recording(positions), ("1",), STEP * row).history.states[:, 0]
    dt = STEP / RATE
    np.testing.assert_allclose(states[1:, :2], states[:-1, :2] + dt * states[1:, 2:], atol=1e-12)
    # The row before the window's first counts as well.
    begin = row + 1 - Grid.of(recording(positions)).observed
    np.testing.assert_allclose(states[0, 2:], (positions[begin] - positions[begin - 1]) / dt)


def test_the_first_row_has_the_velocity_of_the_second_once_that_is_there():
    track = recording(walked()).track("1")
    late = past_velocities(track, np.array([-STEP, 0, STEP]), RATE)
    assert np.isnan(late[0]).all()
    np.testing.assert_allclose(late[1], (track.position[1] - track.position[0]) * RATE / STEP)
    np.testing.assert_array_equal(late[1], late[2])
    np.testing.assert_array_equal(past_velocities(track, np.array([0]), RATE), [[0.0, 0.0]])


def test_missing_rows_are_bridged_and_have_no_velocity():
    whole = recording(walked()).track("1")
    track = whole.restricted(np.delete(np.arange(ROWS), [4, 5]))
    found = past_velocities(track, STEP * np.arange(3, 7), RATE)
    assert np.isnan(found[[1, 2]]).all()
    way = track.position[4] - track.position[3]
    np.testing.assert_allclose(found[3], way / (3 * STEP / RATE))


def test_velocities_of_filters_are_kept():
    made = recording(walked(), source="dut")
    window = observed_window(made, ("1",), 0, 5, STEP)
    np.testing.assert_array_equal(window.states[:, 0, 2:], made.track("1").velocity[:5])
