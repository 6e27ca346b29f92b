"""Recorded windows become settings of the intersection game."""

import jax.numpy as jnp
import numpy as np
import pytest

from evaluation.windows.junction import recorded_setting
from foresight_env.datasets import Recording, Track


def track(name, kind, start, velocity, first=0, heading=np.nan, count=8):
    steps = np.arange(count)
    return Track(
        name,
        kind,
        first + steps,
        np.asarray(start) + 0.25 * steps[:, None] * np.asarray(velocity),
        np.tile(np.asarray(velocity, dtype=float), (count, 1)),
        np.full(count, heading),
    )


def recording(*tracks):
    return Recording("made", "ind", 4.0, tracks)


def test_a_recorded_window_becomes_a_setting():
    made = recording(
        track("1", "pedestrian", (0.0, 0.0), (0.0, 1.5)),
        track("2", "car", (-9.0, 3.0), (3.0, -4.0)),
        track("3", "truck_bus", (0.0, 20.0), (0.0, 0.0), heading=1.2),
    )
    setting = recorded_setting(made.window(("1", "2", "3"), 0, 8))
    assert setting.kinds == ("pedestrian", "car", "truck_bus")
    np.testing.assert_allclose(setting.initial_state[0], [0.0, 0.0, 0.0, 1.5])
    np.testing.assert_allclose(setting.initial_state[1], [-9.0, 3.0, 5.0, np.arctan2(-4.0, 3.0)])
    np.testing.assert_allclose(setting.initial_state[2], [0.0, 20.0, 0.0, 1.2])
    np.testing.assert_allclose(setting.goals, [[0.0, 2.625], [-3.75, -4.0], [0.0, 20.0]])
    person, car, standing = setting.lanes
    assert (person, standing) == (None, None)
    np.testing.assert_allclose(car.offset(jnp.array([-6.0, -1.0])), 0.0, atol=1e-4)


def test_a_setting_begins_where_everybody_is_there():
    made = recording(
        track("1", "pedestrian", (0.0, 0.0), (0.0, 1.5)),
        track("2", "car", (-9.0, 3.0), (3.0, -4.0), first=2),
    )
    with pytest.raises(ValueError, match="window: 2 not seen in its first frame, 0"):
        recorded_setting(made.window(("1", "2"), 0, 8))
    begun = recorded_setting(made.window(("1", "2"), 2, 8))
    # The person is gone two frames before the end; the goal is where it was seen last.
    np.testing.assert_allclose(begun.goals[0], [0.0, 2.625])


def test_windows_that_make_no_setting_are_refused():
    standing = recording(track("3", "car", (0.0, 20.0), (0.0, 0.0))).window(("3",), 0, 8)
    with pytest.raises(ValueError, match="window: 3 stands in its first frame"):
        recorded_setting(standing)
    moving = recording(track("2", "car", (-9.0, 3.0), (3.0, -4.0))).window(("2",), 0, 8)
    with pytest.raises(ValueError, match="lanes: has 2 entries; expected one per agent, 1"):
        recorded_setting(moving, lanes=(None, None))
