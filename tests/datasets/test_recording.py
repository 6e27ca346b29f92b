"""Tracks, selections, rotations, windows and resampling, by their definitions."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foresight_env.datasets import Recording, Track
from tests.support.made_recordings import random_recording, walk

seeds = st.integers(0, 2**32 - 1)


def _of(*tracks: Track, rate: float = 10.0) -> Recording:
    return Recording(name="test", source="ucy", rate=rate, tracks=tracks)


def test_tracks_are_values() -> None:
    frames = np.arange(3)
    position = np.zeros((3, 2))
    track = Track("1", "car", frames, position, position, np.full(3, np.nan))
    position[0, 0] = 9.0
    assert track.position[0, 0] == 0.0
    assert track == dataclasses.replace(track)
    assert track != dataclasses.replace(track, width=1.0)
    with pytest.raises(ValueError, match="read-only"):
        track.position[0, 0] = 1.0


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"frames": np.array([0, 2, 1])}, "increase"),
        ({"frames": np.array([0, 1, 1])}, "increase"),
        ({"frames": np.array([0.0, 1.0, 2.0])}, "integers"),
        ({"position": np.zeros((2, 2))}, "shape"),
        ({"velocity": np.full((3, 2), np.nan)}, "finite"),
        ({"heading": np.zeros((3, 1))}, "shape"),
    ],
)
def test_impossible_tracks_are_refused(change: dict[str, np.ndarray], problem: str) -> None:
    track = walk("1", "car", range(3), (0, 0), (1, 0), 10.0)
    # With run-time checks of annotations switched on, these refuse some of it first.
    with pytest.raises((ValueError, TypeError)) as caught:
        dataclasses.replace(track, **change)
    assert isinstance(caught.value, TypeError) or problem in str(caught.value)


def test_ids_are_unique_and_known() -> None:
    track = walk("1", "car", range(3), (0, 0), (1, 0), 10.0)
    with pytest.raises(ValueError, match="same agent id"):
        _of(track, track)
    with pytest.raises(ValueError, match="no agent '2'; it has 1"):
        _of(track).track("2")


@settings(max_examples=50, deadline=None)
@given(seed=seeds, first=st.integers(-5, 40), size=st.integers(0, 40), every=st.integers(1, 7))
def test_select_keeps_exactly_the_frames_asked_for(
    seed: int, first: int, size: int, every: int
) -> None:
    recording = random_recording("ind", seed)
    wanted = set(range(first, first + size + 1, every))
    selected = recording.select(frames=(first, first + size), every=every)
    for track in recording.tracks:
        kept = [row for row, frame in enumerate(track.frames.tolist()) if frame in wanted]
        assert (track.agent_id in selected.agents) == bool(kept)
        if kept:
            np.testing.assert_array_equal(
                selected.track(track.agent_id).position, track.position[kept]
            )


@settings(max_examples=50, deadline=None)
@given(seed=seeds, angle=st.floats(-10, 10))
def test_rotation_keeps_lengths_and_turns_directions(seed: int, angle: float) -> None:
    recording = random_recording("ind", seed)
    turned = recording.rotate(angle)
    for before, after in zip(recording.tracks, turned.tracks, strict=True):
        for name in ("position", "velocity"):
            old = getattr(before, name) @ np.array([1, 1j])
            new = getattr(after, name) @ np.array([1, 1j])
            np.testing.assert_allclose(new, old * np.exp(1j * angle), atol=1e-12)
        np.testing.assert_allclose(
            np.exp(1j * after.heading), np.exp(1j * (before.heading + angle)), atol=1e-12
        )
        assert np.all((after.heading >= 0) & (after.heading <= 2 * math.pi))


@settings(max_examples=50, deadline=None)
@given(seed=seeds, first=st.integers(-3, 30), steps=st.integers(1, 20), every=st.integers(1, 4))
def test_window_holds_rows_and_nothing_else(seed: int, first: int, steps: int, every: int) -> None:
    recording = random_recording("ind", seed)
    agents = recording.agents[::-1]
    window = recording.window(agents, first, steps, every)
    for column, agent in enumerate(agents):
        track = recording.track(agent)
        rows = {int(frame): row for row, frame in enumerate(track.frames)}
        for step, frame in enumerate(window.frames.tolist()):
            assert frame == first + every * step
            assert window.times[step] == pytest.approx(every * step / recording.rate)
            assert window.present[step, column] == (frame in rows)
            state = window.states[step, column]
            if frame in rows:
                row = rows[frame]
                expected = [*track.position[row], *track.velocity[row]]
                np.testing.assert_array_equal(state, expected)
                assert window.headings[step, column] == track.heading[row]
            else:
                assert np.isnan(state).all()
                assert np.isnan(window.headings[step, column])


def test_window_steps_by_rows_unless_told() -> None:
    recording = random_recording("ucy", 0)
    assert np.all(np.diff(recording.window(recording.agents[:1], 0, 4).frames) == 10)


def test_unwrapped_headings_do_not_jump() -> None:
    heading = np.linspace(5.0, 8.0, 16)
    track = walk("1", "car", range(16), (0, 0), (1, 0), 10.0)
    track = dataclasses.replace(track, heading=np.mod(heading, 2 * math.pi))
    window = _of(track).window(["1"], -1, 18)
    np.testing.assert_allclose(window.unwrapped_headings()[1:-1, 0], heading)
    assert np.isnan(window.unwrapped_headings()[[0, -1], 0]).all()


@settings(max_examples=50, deadline=None)
@given(start=st.integers(0, 30), count=st.integers(2, 30), dt=st.sampled_from([0.03, 0.1, 0.25]))
def test_resampling_a_straight_walk_is_exact(start: int, count: int, dt: float) -> None:
    velocity = (1.5, -0.5)
    track = walk("1", "car", range(start, start + count), (3, 4), velocity, 10.0, heading=1.0)
    recording = _of(track).resample(dt)
    assert recording.rate == pytest.approx(1 / dt)
    inside = [
        k for k in range(1000) if start / 10 - 1e-9 <= k * dt <= (start + count - 1) / 10 + 1e-9
    ]
    assert bool(recording.tracks) == bool(inside)
    if inside:
        result = recording.track("1")
        np.testing.assert_array_equal(result.frames, inside)
        expected = np.array([3, 4]) + np.outer(np.array(inside) * dt, velocity)
        np.testing.assert_allclose(result.position, expected, atol=1e-9)
        np.testing.assert_allclose(result.heading, 1.0)


def test_resampling_at_the_recorded_rate_changes_nothing() -> None:
    recording = random_recording("ind", 8)
    assert recording.resample(1 / 25.0).tracks == recording.tracks


def test_gaps_are_bridged_only_when_allowed() -> None:
    track = walk("1", "car", range(20), (0, 0), (1, 0), 10.0)
    seen = np.delete(np.arange(20), [8, 9, 10])  # rows 7 and 11 are 0.4 s apart
    recording = _of(track.restricted(seen))
    frames = recording.resample(0.05).track("1").frames
    assert not np.any((frames > 14) & (frames < 22))
    assert {14, 22} <= set(frames.tolist())
    bridged = recording.resample(0.05, maximal_gap=0.4).track("1")
    np.testing.assert_array_equal(bridged.frames, np.arange(39))
    np.testing.assert_allclose(bridged.position[:, 0], np.arange(39) * 0.05, atol=1e-12)
    assert recording.resample(0.05, maximal_gap=0.39).track("1").frames.size == frames.size


def test_headings_are_interpolated_the_shorter_way() -> None:
    track = walk("1", "car", range(2), (0, 0), (1, 0), 10.0)
    track = dataclasses.replace(track, heading=np.array([2 * math.pi - 0.2, 0.2]))
    middle = _of(track).resample(0.05).track("1").heading[1]
    assert math.cos(middle) == pytest.approx(1.0)


def test_wrong_arguments_are_refused() -> None:
    recording = _of(walk("1", "car", range(5), (0, 0), (1, 0), 10.0))
    with pytest.raises(ValueError, match="every"):
        recording.select(every=0)
    with pytest.raises(ValueError, match="behind"):
        recording.select(frames=(3, 2))
    with pytest.raises(ValueError, match="dt"):
        recording.resample(0.0)
    with pytest.raises(ValueError, match="steps"):
        recording.window(["1"], 0, 0)
    with pytest.raises(ValueError, match="different ids"):
        recording.window(["1", "1"], 0, 3)
    with pytest.raises(ValueError, match="finite"):
        recording.rotate(math.nan)
