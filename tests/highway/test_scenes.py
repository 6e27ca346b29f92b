"""Roads, paths along them and the draws of episodes."""

import numpy as np
import pytest

from foresight_env.envs.driving.world import driving_world, off_road
from foresight_env.highway.axes import flipped_places
from foresight_env.highway.networks import crossing
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.routes import POINTS, SPACING, Leg, finer, path_along
from foresight_env.highway.scenes import MOST_CARS, SCENES, draw_driving

ALL = [(name, k) for name in SCENES for k in range(MOST_CARS)]


def test_finer_paths_are_the_same_line():
    path = SCENES["roundabout"].paths[0]
    fine = finer(path)
    np.testing.assert_array_equal(fine[::2], path)
    np.testing.assert_allclose(fine[1::2], 0.5 * (path[:-1] + path[1:]))


@pytest.mark.parametrize(("name", "car"), ALL)
def test_paths_lead_along_lanes(name, car):
    """Points lie on the middle of lanes but where a lane is left, evenly and smoothly."""
    scene = SCENES[name]
    path, journey = scene.paths[car], scene.journeys[car]
    assert path.shape == (POINTS, 4)
    used = path[: int(journey.goal / SPACING) + 1]
    steps = np.hypot(*np.diff(used[:, :2], axis=0).T)
    np.testing.assert_allclose(steps, SPACING, rtol=0.02)
    aims = np.unwrap(np.arctan2(*np.diff(used[:, :2], axis=0).T[::-1]))
    middle = 0.5 * (used[1:, 2] + used[:-1, 2])
    np.testing.assert_allclose(np.cos(aims - middle), 1.0, atol=0.002)
    turned = np.diff(used[:, 2]) / SPACING
    np.testing.assert_allclose(turned, 0.5 * (used[1:, 3] + used[:-1, 3]), atol=0.05)
    lanes = [scene.network.get_lane(index) for index in journey.lanes]
    away = [min(lane.distance(p) for lane in lanes) for p in flipped_places(used[:, :2])]
    assert np.median(away) < 0.1
    assert max(away) < 4.0  # between two lanes
    states = np.column_stack([used[:, :2], np.zeros(len(used)), used[:, 2]])
    assert not off_road(scene, states).any()
    # No path turns more sharply than a car of 5 m can.
    assert np.abs(used[:, 3]).max() < 0.2


@pytest.mark.parametrize("name", SCENES)
def test_every_draw_is_a_legal_episode(name):
    """Also with the widest ranges: no car overlaps another, is off the road or lacks a path."""
    scene = SCENES[name]
    ranges = DrivingRanges(along=2.0, speed=2.0)
    world = driving_world(scene, MOST_CARS, ranges, 0.1, 1)
    for seed in range(20):
        drawn = world.draw(np.random.default_rng(seed))
        states = drawn.initial_state
        gaps = world.gaps(states, np.zeros((MOST_CARS, 2)), states)
        assert gaps.min() > 0.0
        assert not off_road(scene, states).any()
        assert (states[:, 2] > 0.0).all()
        for state, theta in zip(states, drawn.theta, strict=True):
            behind = np.linalg.norm(theta["path"][:, :2] - state[:2], axis=1)
            assert SPACING * np.argmin(behind) > 8.0
            away = np.linalg.norm(theta["path"][:, :2] - theta["goal"], axis=1)
            assert away.min() < SPACING


def test_fewer_cars_are_the_first_of_more():
    scene = SCENES["merge"]
    drawn = draw_driving(np.random.default_rng(3), scene, 2)
    assert drawn.initial_state.shape == (2, 4)
    np.testing.assert_array_equal(drawn.theta[1]["path"], scene.paths[1])


def test_a_left_turn_turns_left_on_its_circle():
    """Entering northwards at x = 4, leaving westwards at y = 4: y points up."""
    legs = (
        Leg(("south_far", "south_in", 0), 100.0),
        Leg(("south_in", "west_out", 0)),
        Leg(("west_out", "west_end", 0)),
    )
    path = path_along(crossing(), legs)
    np.testing.assert_allclose(path[0, :3], [4.0, -34.0, np.pi / 2.0], atol=0.01)
    np.testing.assert_allclose(path[-1, 1:3], [4.0, np.pi], atol=0.02)
    turning = path[(path[:, 2] > 1.9) & (path[:, 2] < 2.8)]
    np.testing.assert_allclose(np.hypot(*(turning[:, :2] + 14.0).T), 18.0, atol=0.05)
    np.testing.assert_allclose(turning[:, 3], 1.0 / 18.0, atol=0.01)


def test_lanes_drive_on_the_right():
    network = crossing()
    for arm, outward in (
        ("south", (0, -1)),
        ("west", (-1, 0)),
        ("north", (0, 1)),
        ("east", (1, 0)),
    ):
        lane = network.get_lane((f"{arm}_far", f"{arm}_in", 0))
        place = flipped_places(lane.position(0.5 * lane.length, 0.0))
        ahead = -np.array(outward, dtype=float)
        right = np.array([ahead[1], -ahead[0]])
        assert place @ right == pytest.approx(4.0)
