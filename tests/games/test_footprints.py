"""Gaps between footprints, against an independent reckoning by dense sampling of outlines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foresight_env.games.footprints import RESOLUTION, Footprint, Motion, gap, least_gap

CAR, PEDESTRIAN = Footprint(4.5, 1.8), Footprint(radius=0.25)
angles = st.floats(-4.0, 4.0)
shapes = st.sampled_from([CAR, PEDESTRIAN, Footprint(2.0, 0.2), Footprint(1.0, 1.0, 0.3)])


def one_gap(first, second, place, heading=0.0, other=0.0):
    arguments = (np.array([place], dtype=float), np.array([heading]), np.array([other]))
    return float(gap(first, second, *arguments)[0])


def outline(shape, place, heading):
    """Points around the box, its border left out."""
    along = np.linspace(-0.5, 0.5, 61)
    ends = np.full(61, 0.5)
    box = np.concatenate(
        [np.stack(pair, axis=1) for e in (-ends, ends) for pair in ((along, e), (e, along))]
    )
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    return np.asarray(place) + (box * [shape.length, shape.width]) @ turn


def contains(shape, place, heading, points):
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    own = (points - place) @ turn
    return (np.abs(own) <= [0.5 * shape.length, 0.5 * shape.width]).all(axis=1)


@pytest.mark.parametrize(
    ("first", "second", "place", "other", "expected"),
    [
        (CAR, PEDESTRIAN, (3.0, 0.0), 0.0, 0.5),
        (CAR, PEDESTRIAN, (2.25 + 3.0, 0.9 + 4.0), 0.0, 4.75),
        (CAR, PEDESTRIAN, (2.0, 0.0), 0.0, -0.5),
        (CAR, CAR, (0.0, 3.0), np.pi / 2, -0.15),
        (CAR, CAR, (5.5, 0.0), 0.0, 1.0),
        (PEDESTRIAN, PEDESTRIAN, (0.3, 0.4), 0.0, 0.0),
    ],
)
def test_known_gaps(first, second, place, other, expected):
    assert one_gap(first, second, place, 0.0, other) == pytest.approx(expected, abs=1e-12)


@settings(max_examples=150, deadline=None)
@given(shapes, shapes, st.floats(-6, 6), st.floats(-6, 6), angles, angles)
def test_gap_is_the_distance_of_the_outlines(first, second, x, y, heading, other):
    found = one_gap(first, second, (x, y), heading, other) + first.radius + second.radius
    a, b = outline(first, (0.0, 0.0), heading), outline(second, (x, y), other)
    sampled = float(np.min(np.linalg.norm(a[:, None] - b[None], axis=2)))
    overlap = (
        contains(first, (0.0, 0.0), heading, b).any()
        or contains(second, np.array([x, y]), other, a).any()
    )
    if overlap:
        assert found <= 1e-9
        return
    # Outlines are sampled at 7.5 cm: the nearest samples are that far from the nearest points.
    assert found <= sampled + 1e-9
    assert found >= sampled - 0.08


@settings(max_examples=100, deadline=None)
@given(shapes, shapes, st.floats(-6, 6), st.floats(-6, 6), angles, angles)
def test_moving_by_the_overlap_parts_them(first, second, x, y, heading, other):
    found = one_gap(first, second, (x, y), heading, other)
    assert found == pytest.approx(one_gap(second, first, (-x, -y), other, heading), abs=1e-9)
    if found >= 0.0:
        return
    ways = np.linspace(0.0, 2.0 * np.pi, 721)
    places = np.array([x, y]) - found * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    moved = gap(first, second, places, np.full(721, heading), np.full(721, other))
    assert moved.max() > -2e-4  # one direction, to half a degree, is enough
    assert moved.max() < 1e-9  # and no shorter move is


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(-4, 4), min_size=8, max_size=8),
    angles,
    angles,
    st.floats(-1, 1),
    st.floats(-1, 1),
)
def test_least_gap_is_that_of_fine_sampling(places, heading, other, turn, other_turn):
    a, b, c, d = np.array(places).reshape(4, 2)
    least = least_gap(CAR, CAR, Motion(a, b, heading, turn), Motion(c, d, other, other_turn))
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    relative = c + s * (d - c) - a - s * (b - a)
    fine = gap(CAR, CAR, relative, heading + turn * s[:, 0], other + other_turn * s[:, 0]).min()
    assert least <= fine + RESOLUTION
    assert least >= fine - 0.01  # between the fine samples
