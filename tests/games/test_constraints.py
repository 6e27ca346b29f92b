"""Bounds and distance constraints."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import Bounds, MinimumDistance, SharedMinimumDistance


def test_a_number_bounds_every_entry():
    assert Bounds.box(-1, 2, 3) == Bounds(((-1.0,) * 3,), ((2.0,) * 3,))


def test_bounds_per_entry_and_per_stage():
    free = float("inf")
    bounds = Bounds.box([-free, 0.0], np.array([[1.0, 1.0], [2.0, free]]), 2)
    assert bounds.lower == ((-free, 0.0),)
    assert bounds.upper == ((1.0, 1.0), (2.0, free))


@pytest.mark.parametrize(
    ("lower", "upper", "named"),
    [
        ([0.0, 0.0], 1.0, "lower: has shape"),
        (0.0, np.ones((4, 2)), "upper: has shape"),
        (0.0, np.ones((2, 4, 3)), "upper: has shape"),
        (np.nan, 1.0, "lower: contains NaN"),
        (0.0, [1.0, np.nan, 1.0], "upper: contains NaN"),
        (1.0, 1.0, "lower: must be below upper"),
        (2.0, 1.0, "lower: must be below upper"),
    ],
)
def test_bad_bounds_name_the_argument(lower, upper, named):
    with pytest.raises(ValueError, match=named):
        Bounds.box(lower, upper, 3)


POSITIONS = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]])


def states():
    return tuple(jnp.asarray(np.concatenate([p, [9.0, 9.0]])) for p in POSITIONS)


def test_keep_apart_is_the_papers_squared_distance():
    with jax.enable_x64(True):
        own = MinimumDistance("limit")(1, 1, states(), (), {"limit": np.array(2.0)})
        number = MinimumDistance(2.0)(1, 1, states(), (), {})
    np.testing.assert_allclose(own, [25.0 - 2.0, 18.0 - 2.0])
    np.testing.assert_allclose(number, own)


def test_keep_all_apart_has_one_row_per_pair():
    with jax.enable_x64(True):
        rows = SharedMinimumDistance(1.5)(1, states(), (), ({}, {}, {}))
    np.testing.assert_allclose(rows, [25.0 - 1.5, 1.0 - 1.5, 18.0 - 1.5])
