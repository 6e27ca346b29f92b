"""Likely routes of cars, on tracks whose continuation is known."""

import numpy as np
import pytest

from foresight_env.highway.axes import flipped_places
from foresight_env.highway.likely_route import likely_path
from foresight_env.highway.routes import POINTS, SPACING
from foresight_env.highway.scenes import SCENES

WINDOW = 10


def driven(scene, car, end, speed=8.0, noise=0.0, seed=0):
    """The last places of a car that has come so far along its path (m), and its heading."""
    path = SCENES[scene].paths[car]
    at = end - 0.1 * speed * np.arange(WINDOW)[::-1]
    nodes = SPACING * np.arange(len(path))
    places = np.stack([np.interp(at, nodes, path[:, k]) for k in range(2)], axis=1)
    random = np.random.default_rng(seed)
    noisy = places + noise * random.standard_normal(places.shape)
    return noisy, float(np.interp(end, nodes, path[:, 2]))


def distance(path, places):
    """Of places (K, 2) from a path's points, m."""
    return np.linalg.norm(places[:, None] - path[:, :2], axis=2).min(axis=1)


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize(
    ("scene", "car", "end"),
    [
        ("left_turn", 1, 30.0),  # straight on before the crossing, where it might turn
        ("left_turn", 0, 40.0),  # half-way through the left turn
        ("left_turn", 2, 48.0),  # half-way through the right turn
        ("merge", 1, 60.0),
        ("lane_change", 2, 40.0),
        ("roundabout", 1, 75.0),  # on the roundabout
    ],
)
def test_the_next_metres_are_on_the_likely_path(scene, car, end, noise):
    track, heading = driven(scene, car, end, noise=noise)
    found = likely_path(SCENES[scene], track, heading)
    path = SCENES[scene].paths[car]
    ahead = path[int(end / SPACING) : int((end + 12.0) / SPACING), :2]
    assert distance(found, ahead).max() < 1.2


def test_without_a_heading_the_track_tells_it():
    track, _ = driven("left_turn", 1, 20.0)
    found = likely_path(SCENES["left_turn"], track, float("nan"))
    place = np.argmin(np.linalg.norm(found[:, :2] - track[-1], axis=1))
    assert np.cos(found[place, 2] + np.pi / 2.0) == pytest.approx(1.0, abs=1e-3)  # southwards


def test_off_every_road_straight_on():
    track = np.array([[70.0, 70.0], [70.5, 70.5]])
    found = likely_path(SCENES["left_turn"], track, float("nan"))
    np.testing.assert_allclose(found[:, 2], np.pi / 4.0)
    np.testing.assert_allclose(distance(found, track), 0.0, atol=0.8)


def reference(scene, lane, places):
    """(K,) distances of places from a lane's middle by highway-env, m."""
    there = SCENES[scene].network.get_lane(lane)
    return np.array([abs(there.local_coordinates(flipped_places(p))[1]) for p in places])


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_track_along_a_straight_lane_is_followed_along_that_lane(number):
    """By definition: the path is the lane's middle, at even distances, without curvature."""
    lane = ("0", "1", number)
    there = SCENES["lane_change"].network.get_lane(lane)
    at = np.arange(100.0, 105.0)
    track = np.array([flipped_places(there.position(s, 0.0)) for s in at])
    found = likely_path(SCENES["lane_change"], track, float("nan"))
    assert found.shape == (POINTS, 4)
    np.testing.assert_allclose(reference("lane_change", lane, found[:, :2]), 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(found[:, 0]), SPACING, atol=1e-3)
    np.testing.assert_allclose(found[:, 2:], 0.0, atol=1e-6)
    along = found[:, 0] - track[-1, 0]
    assert -35.0 < along[0] < -10.0  # a little of the lane behind the car, the rest ahead
    assert along[-1] > 100.0


@pytest.mark.parametrize("offset", [-1.0, 1.0])
def test_a_car_beside_its_lane_s_middle_is_on_the_lane_all_the_same(offset):
    lane = ("0", "1", 1)
    there = SCENES["lane_change"].network.get_lane(lane)
    track = np.array([flipped_places(there.position(s, offset)) for s in np.arange(100.0, 105.0)])
    found = likely_path(SCENES["lane_change"], track, 0.0)
    np.testing.assert_allclose(reference("lane_change", lane, found[:, :2]), 0.0, atol=1e-6)


def test_the_track_decides_between_ways_that_part():
    """Three cars come from the north; each way is recognised once it has been entered."""
    paths = SCENES["left_turn"].paths
    for car, end in ((1, 60.0), (2, 52.0)):
        track, heading = driven("left_turn", car, end)
        found = likely_path(SCENES["left_turn"], track, heading)
        later = paths[car][int((end + 10.0) / SPACING) : int((end + 30.0) / SPACING), :2]
        assert distance(found, later).max() < 1.2
        other = paths[3 - car][int((end + 25.0) / SPACING) : int((end + 30.0) / SPACING), :2]
        assert distance(found, other).max() > 3.0


def test_paths_are_shared_and_cannot_be_changed():
    track, heading = driven("merge", 1, 60.0)
    one, two = (likely_path(SCENES["merge"], track, heading) for _ in range(2))
    assert one is two
    with pytest.raises(ValueError, match="read-only"):
        one[0, 0] = 0.0
