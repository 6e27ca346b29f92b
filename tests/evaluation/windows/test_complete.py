"""Windows of 8 + 12 steps: who counts, who is context, and that nothing later is known."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.windows.complete import (
    MOST_AGENTS,
    OBSERVED,
    REACH,
    complete_agents,
    histories_at,
    near_groups,
    step_frames,
)
from foresight_env.datasets import Recording
from tests.support.made_scenes import crossing, straight, turning


@pytest.mark.parametrize(("rate", "every"), [(15.0, 6), (25.0, 10)])
def test_every_window_of_20_rows(rate, every):
    """22 rows hold three windows; the agent of 12 rows is in none."""
    made = crossing("made", rate)
    assert step_frames(made) == every
    found = complete_agents(made)
    assert found == {frame * every: ("1", "2", "3") for frame in (7, 8, 9)}


def test_an_agent_with_a_gap_does_not_count():
    made = crossing("made")
    track = made.track("1")
    gappy = replace(made, tracks=(track.restricted(track.frames != 150), *made.tracks[1:]))
    assert set(complete_agents(gappy).values()) == {("2", "3")}


def test_near_agents_form_a_history_and_the_others_are_context():
    made = crossing("made")
    first, second = histories_at(made, 70, ("1", "2", "3"))
    assert (first.agents, second.agents) == (("1", "2", "4"), ("3",))
    assert first.counted.tolist() == [True, True, False]
    assert first.history.dt == pytest.approx(0.4)
    np.testing.assert_array_equal(first.history.states[-1, 0, :2], made.track("1").position[7])
    np.testing.assert_array_equal(first.truth[:, 0], made.track("1").position[8:20])
    # The agent that leaves after row 11 has four more positions.
    assert np.isfinite(first.truth[:4, 2]).all()
    assert np.isnan(first.truth[4:, 2]).all()
    # A step before row 0 is unknown, so the agent that came a row before now is no context.
    late = Recording("made", "ucy", 25.0, (*made.tracks, straight(5, (0, 0), (1, 0), 25.0, 7, 9)))
    assert "5" not in next(iter(histories_at(late, 70, ("1", "2", "3")))).agents
    assert "5" in next(iter(histories_at(late, 80, ("1", "2", "3")))).agents


def test_velocities_are_differences_of_observed_positions():
    """Neither the recorded ones nor a position after the last observed one, or before the first."""
    made = turning(crossing("made"), step=8)  # turns after row 8
    at = {frame: next(iter(histories_at(made, frame, ("1", "2", "3")))) for frame in (70, 80, 90)}
    for frame in (70, 80):
        np.testing.assert_allclose(at[frame].history.states[:, 0, 2:], [[1.0, 0.0]] * OBSERVED)
    np.testing.assert_allclose(at[90].history.states[-1, 0, 2:], [0.0, 1.0], atol=1e-9)
    # Row 0 is before the window whose last observed frame is 80.
    track = made.track("1")
    moved = replace(track, position=np.where(track.frames[:, None] < 10, 50.0, track.position))
    other = replace(made, tracks=(moved, *made.tracks[1:]))
    theirs = next(iter(histories_at(other, 80, ("1", "2", "3"))))
    np.testing.assert_array_equal(at[80].history.states, theirs.history.states)


@pytest.mark.parametrize("seed", range(5))
def test_each_agent_counts_once(seed):
    random = np.random.default_rng(seed)
    places = random.uniform(0.0, 60.0, (40, 2))
    groups = near_groups(places, 30)
    counted = [i for group, mask in groups for i, own in zip(group, mask, strict=True) if own]
    assert sorted(counted) == list(range(30))
    for group, mask in groups:
        assert len(group) <= MOST_AGENTS
        assert mask[0]
        away = np.linalg.norm(places[group] - places[group[0]], axis=1)
        assert (away <= REACH).all()
        rest = np.delete(np.linalg.norm(places - places[group[0]], axis=1), group)
        assert len(group) == MOST_AGENTS or (rest > REACH).all()
        assert rest.min() >= away.max() or len(group) < MOST_AGENTS
