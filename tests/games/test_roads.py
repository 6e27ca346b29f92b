"""Corners, road sides and lanes against their definitions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foresight_env.games import Circle, Lane, LaneCenter, OutsideCircles, RoadBoundary, RoadSide


@pytest.fixture(autouse=True, scope="module")
def double_precision():
    with jax.enable_x64(True):
        yield


PLACE = st.tuples(*[st.floats(-50.0, 50.0)] * 2)


def at(position):
    return (jnp.array([*position, 0.0, 0.0]),)


@given(PLACE, PLACE, PLACE)
def test_a_circle_goes_through_its_points(a, b, c):
    sides = np.subtract(b, a), np.subtract(c, a)
    area = abs(sides[0][0] * sides[1][1] - sides[0][1] * sides[1][0])
    if area < 1.0:
        return
    circle = Circle.through(a, b, c)
    gaps = [np.hypot(*np.subtract(p, circle.center)) - circle.radius for p in (a, b, c)]
    np.testing.assert_allclose(gaps, 0.0, atol=1e-6 * max(1.0, circle.radius))


@pytest.mark.parametrize(("begin", "end"), [((-5.0, 1.0), (45.0, 9.0)), ((45.0, 9.0), (-5.0, 1.0))])
def test_a_centre_line_is_where_the_offset_is_0(begin, end):
    along = np.linspace(0.0, 40.0, 30)
    lane = Lane.fit(np.column_stack([along, 0.005 * along**2]))
    line = lane.centre_line(begin, end)
    offsets = [float(lane.offset(jnp.array(place))) for place in line[:, :2]]
    np.testing.assert_allclose(offsets, 0.0, atol=1e-3)
    np.testing.assert_allclose(line[0, :2], begin, atol=1.5)
    steps = np.diff(line[:, :2], axis=0)
    np.testing.assert_allclose(np.hypot(*steps.T), 1.0, atol=1e-3)
    middle = 0.5 * (line[1:, 2] + line[:-1, 2])
    turned = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    np.testing.assert_allclose(steps, turned, atol=2e-3)
    # Within the points that the lane was fitted to, headings change as curvatures say.
    inside = (line[1:, 0] > 1.0) & (line[1:, 0] < 39.0)
    curvature = 0.5 * (line[1:, 3] + line[:-1, 3])
    np.testing.assert_allclose(np.diff(line[:, 2])[inside], curvature[inside], atol=1e-4)


def test_no_circle_through_a_line():
    with pytest.raises(ValueError, match="no circle goes through"):
        Circle.through((0.0, 0.0), (1.0, 1.0), (3.0, 3.0))


def test_outside_of_circles():
    inside, beside = (2.5, 0.0), (4.5, 0.0)
    circles = (Circle((2.0, 0.0), 2.0), Circle((0.0, 9.0), 1.0))
    values = [np.asarray(OutsideCircles(circles)(0, 1, at(p), (), {})) for p in (inside, beside)]
    np.testing.assert_allclose(values, [[0.25 - 4.0, 86.25], [2.25, 100.25]])
    shrunk = OutsideCircles(circles, 0.2)(0, 1, at(inside), (), {})
    np.testing.assert_allclose(shrunk, [0.25 - 0.16, 87.25 - 0.04])


@pytest.mark.parametrize(("road", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_road_side_holds_along_its_road_and_nowhere_behind(road, sign):
    side = RoadBoundary((RoadSide((1.0, 0.0), (3.0, 0.0), road),))
    far_ahead = np.asarray(side(0, 1, at((30.0, 2.0)), (), {}))
    np.testing.assert_allclose(far_ahead, [2.0 * sign], atol=1e-9)
    for y in (-10.0, 10.0):
        assert side(0, 1, at((-5.0, y)), (), {})[0] > 30.0


def test_road_sides_are_checked():
    with pytest.raises(ValueError, match="two different places"):
        RoadSide((0.0, 0.0), (0.0, 0.0), "left")
    with pytest.raises(ValueError, match="sides: is empty"):
        RoadBoundary(())
    side = RoadSide((0.0, 0.0), (1.0, 0.0), "left")
    with pytest.raises(ValueError, match=r"sharpness, lift: are 0\.0 and 50\.0"):
        RoadBoundary((side,), sharpness=0.0)


def test_circles_are_checked():
    with pytest.raises(ValueError, match="a radius above 0"):
        Circle((0.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="no circle goes through"):
        Circle.through((0.0, 0.0), (np.nan, 1.0), (3.0, 3.0))
    with pytest.raises(ValueError, match="expected at least one circle"):
        OutsideCircles(())


@settings(deadline=None)
@given(st.floats(-3.0, 3.0), PLACE, st.floats(0.5, 40.0), st.floats(-5.0, 5.0))
def test_the_offset_from_a_straight_lane_is_the_distance(angle, start, length, across):
    along = np.array([np.cos(angle), np.sin(angle)])
    left = np.array([-along[1], along[0]])
    lane = Lane.fit(np.asarray(start) + np.linspace(0.0, length, 7)[:, None] * along)
    place = np.asarray(start) + 0.3 * length * along + across * left
    np.testing.assert_allclose(lane.offset(jnp.asarray(place)), across, atol=1e-6)


def test_a_lane_goes_through_the_points_that_it_was_fitted_to():
    angle = np.linspace(0.0, 1.2, 30)
    points = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [3.0, -7.0]
    lane = Lane.fit(points)
    offsets = [float(lane.offset(jnp.asarray(p))) for p in points]
    assert np.abs(offsets).max() < 0.02
    outward = 20.4 * np.array([np.cos(0.6), np.sin(0.6)]) + [3.0, -7.0]
    np.testing.assert_allclose(
        lane.offset(jnp.asarray(outward)), -0.4, atol=0.02
    )  # the bend goes left
    length = np.hypot(*(points[-1] - points[0]))
    drawn = lane.points(np.linspace(0.0, length, 9))
    np.testing.assert_allclose(np.hypot(*(drawn - [3.0, -7.0]).T), 20.0, atol=0.02)


def test_beyond_its_points_a_lane_goes_on_straight():
    angle = np.linspace(0.0, 1.2, 30)
    lane = Lane.fit(20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    start, end = lane.reach
    for edge, beyond in ((start, start - 30.0), (end, end + 30.0)):
        inner, at_edge, far = lane.points(
            np.array([edge + np.sign(edge - beyond) * 1e-4, edge, beyond])
        )
        tangent, onward = at_edge - inner, far - at_edge
        cross = tangent[0] * onward[1] - tangent[1] * onward[0]
        assert abs(cross) < 1e-3 * np.hypot(*tangent) * np.hypot(*onward)
        np.testing.assert_allclose(lane.offset(jnp.asarray(far)), 0.0, atol=1e-9)


def test_a_lane_reaches_forward():
    with pytest.raises(ValueError, match="reach: is"):
        Lane((1.0, 0.0), reach=(5.0, 0.0))


def test_the_cost_of_a_lane_is_its_squared_offset():
    lane = Lane((0.05, 0.2, 1.0), (1.0, 2.0), 0.4)
    x = at((4.0, 5.0))
    expected = 3.0 * float(lane.offset(x[0][:2])) ** 2
    np.testing.assert_allclose(LaneCenter(lane, "w")(0, 1, x, (), {"w": 3.0}), expected)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((1, 2)), "expected"),
        (np.array([[0.0, 0.0], [np.nan, 1.0], [2.0, 2.0]]), "NaN"),
        (np.array([[1.0, 1.0], [2.0, 0.0], [1.0, 1.0]]), "same place"),
        (np.array([[0.0, 0.0], [5.0, 5.0], [4.0, -5.0], [9.0, 0.0]]), "run back by 1.00 m"),
    ],
)
def test_points_that_make_no_lane_are_refused(points, message):
    with pytest.raises(ValueError, match=f"points: .*{message}"):
        Lane.fit(points)
