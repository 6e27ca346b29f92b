"""Where cars are thought to go, on tracks whose continuation is known."""

import numpy as np
import pytest

from foresight_env.highway.likely_route import likely_path
from foresight_env.highway.routes import SPACING
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
