"""Gymnasium's and PettingZoo's wrappers around our environments: `python examples/wrappers.py`.

A film by `RecordVideo` (needs the package moviepy), actions in [-1, 1],
stacked and normalised observations, and an agent-by-agent loop.
"""

from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.wrappers import (
    FrameStackObservation,
    NormalizeObservation,
    RecordEpisodeStatistics,
    RecordVideo,
    RescaleAction,
    TimeLimit,
)
from pettingzoo.utils import parallel_to_aec

import foresight_env.envs  # noqa: F401  (registers the environments)
from foresight_env.envs import driving_v0


def film(folder: Path, steps: int = 15) -> Path:
    """Record one crossing; the film's path."""
    env = gymnasium.make("foresight/Crosswalk-v0", render_mode="rgb_array", max_steps=steps)
    env = RecordVideo(env, str(folder), episode_trigger=lambda _: True, disable_logger=True)
    seen, _ = env.reset(seed=0)
    done = False
    while not done:
        action = np.clip(seen[-2:] - seen[:2], -10.0, 10.0).astype(np.float32)
        seen, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
    env.close()  # writes it
    return next(folder.glob("*.mp4"))


def stacked(steps: int = 12) -> tuple[tuple[int, ...], float]:
    """An episode with the usual wrappers of trainers: shape of an observation, and the return."""
    env = gymnasium.make("foresight/Crosswalk-v0", observation="positions")
    env = RecordEpisodeStatistics(TimeLimit(env, steps))
    env = RescaleAction(env, np.float32(-1.0), np.float32(1.0))
    env = FrameStackObservation(NormalizeObservation(env), 4)
    seen, _ = env.reset(seed=1)
    done, info = False, {}
    while not done:
        seen, _, terminated, truncated, info = env.step(env.action_space.sample() * 0.1)
        done = terminated or truncated
    env.close()
    return seen.shape, float(info["episode"]["r"])


def agent_by_agent(steps: int = 6) -> dict[str, float]:
    """All agents controlled, one after the other: the summed rewards of each."""
    env = parallel_to_aec(
        driving_v0.parallel_env(cars=2, controlled="all", planning_horizon=4, max_steps=steps)
    )
    env.reset(seed=0)
    earned = dict.fromkeys(env.possible_agents, 0.0)
    for agent in env.agent_iter():
        _, reward, terminated, truncated, _ = env.last()
        earned[agent] += float(reward)
        over = terminated or truncated
        env.step(None if over else np.zeros(2, np.float32))
    env.close()
    return earned


if __name__ == "__main__":
    print("film:", film(Path("results/film")))
    print("stacked observation, return:", *stacked())
    print("rewards:", agent_by_agent())
