"""Routes learned from tracks that ended: one per way, counted, with heading and curvature."""

from dataclasses import replace

import numpy as np
import pytest

from foresight_env.datasets import (
    Recording,
    RouteMemory,
    Track,
    ahead_of,
    learned_routes,
    routes_at,
)

RATE = 10.0


def drive(name, first, radius=None, shift=0.0, speed=6.0, seconds=5.0, kind="car"):
    """A car that goes east from the origin and, given a radius, left on a circle."""
    times = np.arange(round(seconds * RATE)) / RATE
    along = speed * times
    if radius is None:
        places, heading = np.stack([along, 0.0 * along], axis=1), 0.0 * along
    else:
        heading = along / radius
        places = radius * np.stack([np.sin(heading), 1.0 - np.cos(heading)], axis=1)
    places = places + shift * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    velocity = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return Track(name, kind, first + np.arange(len(times)), places, velocity, heading)


def recorded(*tracks):
    return Recording("made", "dut", RATE, tracks)


def test_tracks_side_by_side_are_one_route():
    tracks = drive("a", 0), drive("b", 30, shift=0.8), drive("c", 60, radius=20.0)
    routes = learned_routes(recorded(*tracks), before=200)
    assert [r.frequency for r in routes] == [2, 1]
    straight, turn = (r.path for r in routes)
    np.testing.assert_allclose(straight[:, 2:], 0.0, atol=1e-6)
    np.testing.assert_allclose(turn[:, 3], 1.0 / 20.0, atol=2e-3)
    np.testing.assert_allclose(turn[:, 2], np.arange(len(turn)) / 20.0, atol=0.01)


def test_only_tracks_that_ended_count_and_only_vehicles():
    tracks = drive("a", 0), drive("b", 30, radius=20.0), drive("p", 0, radius=10.0, kind="bicycle")
    assert learned_routes(recorded(*tracks), before=49) == ()
    assert len(learned_routes(recorded(*tracks), before=50)) == 1
    assert len(learned_routes(recorded(*tracks), before=80)) == 2


def test_the_longer_of_two_tracks_is_the_route():
    tracks = drive("a", 0, seconds=3.0), drive("b", 40, seconds=6.0)
    (route,) = learned_routes(recorded(*tracks), before=200)
    assert route.frequency == 2
    assert route.path[-1, 0] == pytest.approx(35.0, abs=1.0)


def test_parked_cars_have_no_route():
    parked = drive("a", 0, speed=0.01, seconds=200.0)
    trembling = 0.02 * np.random.default_rng(0).standard_normal(parked.position.shape)
    shaken = replace(parked, position=parked.position + trembling)
    assert learned_routes(recorded(shaken), before=3000) == ()


def test_a_memory_has_the_routes_of_every_frame():
    tracks = drive("a", 0), drive("b", 30, shift=0.8), drive("c", 60, radius=20.0)
    memory = RouteMemory(recorded(*tracks))
    for frame in (200, 40, 85, 50, 120):
        found, expected = memory.before(frame), learned_routes(recorded(*tracks), frame)
        assert [r.frequency for r in found] == [r.frequency for r in expected]
        for route, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(route.path, other.path)


def test_routes_at_a_place_need_its_heading():
    routes = learned_routes(recorded(drive("a", 0), drive("b", 0, radius=15.0)), before=200)
    assert len(routes_at(routes, np.array([2.0, 0.1]), 0.05)) == 2
    assert len(routes_at(routes, np.array([25.0, 0.1]), 0.0)) == 1
    assert routes_at(routes, np.array([25.0, 0.1]), np.pi) == ()
    assert routes_at(routes, np.array([25.0, 9.0]), 0.0) == ()


def test_routes_go_straight_on_beyond_their_ends():
    (route,) = learned_routes(recorded(drive("a", 0, radius=20.0)), before=200)
    part = ahead_of(route, np.array([0.0, 0.0]), 5.0, 60.0)
    spacing = np.hypot(*np.diff(part[:, :2], axis=0).T)
    np.testing.assert_allclose(spacing, 1.0, atol=0.02)
    assert len(part) == 66
    np.testing.assert_allclose(part[:5, 1], 0.0, atol=0.1)  # back from where it begins
    assert (part[40:, 3] == 0.0).all()
    np.testing.assert_allclose(part[40:, 2], route.path[-1, 2])
