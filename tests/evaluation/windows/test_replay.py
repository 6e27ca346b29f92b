"""Episodes among recorded agents: who takes part, that tracks are followed, refusals."""

import numpy as np
import pytest

from agents import constant_velocity
from evaluation.windows.replay import (
    GOAL_PART,
    GOAL_RADIUS,
    LEAST_GAP,
    MOST_OTHERS,
    ReplayEnv,
    replayed_episodes,
)


@pytest.fixture(scope="module")
def episodes():
    """Those of the recording that the project makes itself."""
    return replayed_episodes(None, "test")


def test_episodes_of_a_recording(episodes):
    assert len({episode.name for episode in episodes}) == len(episodes) > 1
    assert any("car" in episode.kinds for episode in episodes)
    for episode in episodes:
        assert episode.kinds[0] == "pedestrian"
        assert 1 < len(episode.kinds) <= 1 + MOST_OTHERS
        assert np.isfinite(episode.tracks).all()
        assert episode.tracks.shape == (episode.steps + 1, len(episode.kinds), 4)
        there = episode.tracks[round(GOAL_PART * episode.steps), 0, :2]
        np.testing.assert_array_equal(episode.goal, there)


def test_others_follow_their_tracks_whatever_the_ego_does(episodes):
    for episode in episodes:
        env = ReplayEnv(episode)
        _, infos = env.reset(seed=0)
        agent = env.agents[0]
        assert infos[agent]["min_distance"] >= LEAST_GAP
        assert set(env.scene.opponent_prior.free) <= set(env.scene.own(agent).theta)
        steps = 0
        while env.agents:
            _, _, _, _, infos = env.step({agent: np.array([-1.0, 0.5], dtype=np.float32)})
            steps += 1
            away = infos[agent]["state"][1:, :2] - episode.tracks[steps, 1:, :2]
            assert np.hypot(*away.T).max() < 0.1
        assert steps > 5


def test_an_ego_walks_to_the_goal(episodes):
    env = ReplayEnv(episodes[0])
    observations, infos = env.reset(seed=0)
    agent, policy = env.agents[0], constant_velocity()
    memory = policy.init(env.scene, agent)
    while env.agents:
        memory = policy.update(memory, observations[agent], infos[agent])
        decision, memory = policy.act(memory)
        observations, _, _, _, infos = env.step({agent: decision.action})
    away = infos[agent]["state"][0, :2] - episodes[0].goal
    assert infos[agent]["goal_reached"] == (np.hypot(*away) <= GOAL_RADIUS)
    assert np.hypot(*away) < np.hypot(*(episodes[0].tracks[0, 0, :2] - episodes[0].goal))


def test_recordings_without_an_episode_are_refused(tmp_path):
    (tmp_path / "zara01_obsmat.txt").write_text("0 1 0 0 0 0 0 0\n10 1 1 0 0 1 0 0\n")
    with pytest.raises(ValueError, match="--data: no recording of the test split"):
        replayed_episodes(tmp_path, "test")
