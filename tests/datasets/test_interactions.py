"""Crossings that are known by construction."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from foresight_env.datasets import Recording, Track, closest_crossings, find_interaction
from tests.support.made_recordings import walk

RATE = 10.0


def _of(*tracks: Track) -> Recording:
    return Recording(name="test", source="ucy", rate=RATE, tracks=tracks)


def _through(agent: str, point: np.ndarray, time: float, speed: float, course: float) -> Track:
    """Return a walk of 20 s that is at `point` at `time`."""
    velocity = speed * np.array([math.cos(course), math.sin(course)])
    start = point - time * velocity
    return walk(
        agent, "pedestrian", range(200), (start[0], start[1]), (velocity[0], velocity[1]), RATE
    )


@settings(max_examples=100, deadline=None)
@given(
    x=st.floats(-20, 20),
    y=st.floats(-20, 20),
    times=st.tuples(st.floats(3, 17), st.floats(3, 17)),
    speeds=st.tuples(st.floats(0.5, 8), st.floats(0.5, 8)),
    course=st.floats(-3, 3),
    angle=st.floats(0.6, 2.5),
)
# At a row of the second track: rounding had put it beyond the ends of both its segments.
@example(
    x=0.0, y=0.5, times=(6.33645225792958, 3.0), speeds=(3.0000000000000004, 3.0),
    course=0.008705933786447564, angle=1.34375,
)  # fmt: skip
def test_straight_walks_cross_where_they_were_made_to(
    x: float,
    y: float,
    times: tuple[float, float],
    speeds: tuple[float, float],
    course: float,
    angle: float,
) -> None:
    assume(abs(times[0] - times[1]) > 1e-6)
    point = np.array([x, y])
    tracks = (
        _through("a", point, times[0], speeds[0], course),
        _through("b", point, times[1], speeds[1], course + angle),
    )
    recording = _of(*tracks)
    found = find_interaction(recording, ("b", "a"))
    assert found.agents == (("a", "b") if times[0] < times[1] else ("b", "a"))
    np.testing.assert_allclose(found.point, point, atol=1e-8)
    np.testing.assert_allclose(found.times, sorted(times), atol=1e-8)
    assert found.separation == 0.0
    assert found.angle == pytest.approx(angle)
    distances = np.linalg.norm(tracks[0].position - tracks[1].position, axis=1)
    assert found.minimum_distance == pytest.approx(distances.min())
    assert distances[found.minimum_distance_frame] == pytest.approx(distances.min())
    listed = closest_crossings(recording, max_time_difference=20.0)
    assert [item.agents for item in listed] == [found.agents]
    window = recording.window(found.agents, found.first_frame, found.steps, found.every)
    assert window.complete
    assert found.steps <= 101
    middle = sum(times) / 2 * RATE
    assert found.first_frame <= middle <= found.first_frame + found.steps


def _cross(second_delay: float, **changes: float) -> Recording:
    origin = np.zeros(2)
    return _of(
        _through("a", origin, 8.0, 1.0, 0.0),
        _through("b", origin, 8.0 + second_delay, changes.get("speed", 1.0), math.pi / 2),
    )


def test_limits_are_honoured() -> None:
    recording = _cross(2.0)
    assert len(closest_crossings(recording, max_time_difference=2.01)) == 1
    assert not closest_crossings(recording, max_time_difference=1.99, reach=0.0)
    assert len(closest_crossings(recording, max_distance=1.42)) == 1  # sqrt(2) m at the least
    assert not closest_crossings(recording, max_distance=1.41)
    assert len(closest_crossings(recording, min_overlap_seconds=20.0)) == 1
    assert not closest_crossings(recording, min_overlap_seconds=20.1)
    assert len(closest_crossings(recording, min_angle=math.pi / 2)) == 1
    assert not closest_crossings(recording, min_speed=1.01)
    assert len(closest_crossings(recording, kinds=("pedestrian", "pedestrian"))) == 1
    assert not closest_crossings(recording, kinds=("car", "pedestrian"))


def test_pairs_are_ranked_and_counted() -> None:
    origin = np.zeros(2)
    delays = {"b": 3.0, "c": 1.0, "d": 2.0}
    tracks = [_through("a", origin, 8.0, 1.0, 0.0)]
    tracks += [
        _through(agent, origin, 8.0 + delay, 1.0, math.pi / 2) for agent, delay in delays.items()
    ]
    found = closest_crossings(_of(*tracks))
    assert [item.agents for item in found] == [("a", "c"), ("a", "d"), ("a", "b")]
    np.testing.assert_allclose([item.time_difference for item in found], [1.0, 2.0, 3.0])
    assert len(closest_crossings(_of(*tracks), count=2)) == 2


def test_parallel_following_and_separate_paths_do_not_cross() -> None:
    recording = _of(
        walk("a", "car", range(100), (0, 0), (1, 0), RATE),
        walk("follower", "car", range(100), (-2, 0), (1, 0), RATE),
        walk("beside", "car", range(100), (0, 1), (1, 0), RATE),
        walk("standing", "car", range(100), (5, 0), (0, 0), RATE),
        walk("far", "car", range(100), (50, 0), (0, 1), RATE),
    )
    assert not closest_crossings(recording)
    with pytest.raises(ValueError, match="do not cross"):
        find_interaction(recording, ("a", "beside"))


def test_agents_of_different_times_do_not_interact() -> None:
    recording = _of(
        walk("a", "car", range(40), (-2, 0), (1, 0), RATE),
        walk("b", "car", range(41, 90), (0, -6), (0, 1), RATE),
    )
    assert not closest_crossings(recording, min_overlap_seconds=0.0)
    with pytest.raises(ValueError, match="never present together"):
        find_interaction(recording, ("a", "b"))


def test_near_crossings_count_within_reach_only() -> None:
    # b walks up to 0.4 m below a's path, and stops being recorded there.
    recording = _of(
        walk("a", "pedestrian", range(101), (-5, 0), (1, 0), RATE),
        walk("b", "pedestrian", range(77), (0, -8.0), (0, 1), RATE),
    )
    assert not closest_crossings(recording, reach=0.0)
    assert not closest_crossings(recording, reach=0.39)
    (found,) = closest_crossings(recording, reach=0.401)
    assert found.separation == pytest.approx(0.4, abs=2e-3)
    np.testing.assert_allclose(found.times, [5.0, 7.6], atol=0.05)
    np.testing.assert_allclose(found.point, [0.0, -0.2], atol=0.05)


def test_gap_in_a_path_is_not_crossed() -> None:
    track = walk("a", "car", range(100), (-5, 0), (1, 0), RATE)
    lost = track.restricted(np.abs(track.position[:, 0]) > 1.0)
    other = walk("b", "car", range(100), (0, -4), (0, 1), RATE)
    assert len(closest_crossings(_of(track, other))) == 1
    assert not closest_crossings(_of(lost, other))


def test_window_does_not_span_a_gap() -> None:
    track = walk("a", "car", range(100), (-5, 0), (1, 0), RATE)
    broken = track.restricted(np.abs(np.arange(100) - 30) > 2)
    other = walk("b", "car", range(100), (0, -4), (0, 1), RATE)
    recording = _of(broken, other)
    found = find_interaction(recording, ("a", "b"), window_seconds=60.0)
    assert (found.first_frame, found.steps) == (33, 67)
    assert recording.window(found.agents, found.first_frame, found.steps, found.every).complete


def test_the_crossing_closest_in_time_counts() -> None:
    # b zigzags across a's straight path at x = 1, 3, 5, ...; a is at x = t - 2.
    frames = np.arange(0, 160)
    time = frames / RATE
    a = walk("a", "pedestrian", range(160), (-2, 0), (1, 0), RATE)
    zigzag = np.abs(np.mod(time, 4.0) - 2.0) - 1.0
    b = Track(
        "b",
        "pedestrian",
        frames,
        np.column_stack([time, zigzag]),
        np.zeros((160, 2)),
        np.full(160, np.nan),
    )
    found = find_interaction(_of(a, b), ("a", "b"))
    assert found.time_difference == pytest.approx(2.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_blocks_find_what_a_plain_search_finds(seed: int) -> None:
    """Long random walks: compare with testing each segment against each other one by one."""
    generator = np.random.default_rng(seed)
    tracks = []
    for agent in ("a", "b"):
        position = generator.normal(size=(90, 2)).cumsum(axis=0)
        nothing = np.full(90, np.nan)
        tracks.append(
            Track(agent, "pedestrian", np.arange(90), position, np.zeros((90, 2)), nothing)
        )
    best = math.inf
    p, q = (track.position for track in tracks)
    for i in range(89):
        for j in range(89):
            matrix = np.column_stack([p[i + 1] - p[i], q[j] - q[j + 1]])
            s, u = np.linalg.solve(matrix, q[j] - p[i])
            if 0 <= s <= 1 and 0 <= u <= 1:
                best = min(best, abs(i + s - j - u) / RATE)
    if math.isinf(best):
        with pytest.raises(ValueError, match="do not cross"):
            find_interaction(_of(*tracks), ("a", "b"), reach=0.0)
    else:
        found = find_interaction(_of(*tracks), ("a", "b"), reach=0.0)
        assert found.time_difference == pytest.approx(best, abs=1e-9)


def test_wrong_arguments_are_refused() -> None:
    recording = _cross(1.0)
    with pytest.raises(ValueError, match="negative"):
        closest_crossings(recording, max_time_difference=-1.0)
    with pytest.raises(ValueError, match="negative"):
        closest_crossings(recording, reach=math.nan)
    with pytest.raises(ValueError, match="count"):
        closest_crossings(recording, count=0)
    with pytest.raises(ValueError, match="min_angle"):
        closest_crossings(recording, min_angle=2.0)
    with pytest.raises(ValueError, match="two different"):
        find_interaction(recording, ("a", "a"))
    assert closest_crossings(_of()) == ()
