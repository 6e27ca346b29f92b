"""Control a pedestrian among others: `python examples/step_loop.py`.

First a Gymnasium loop with a hand-written policy; then the same crossing with a registered ego,
which infers the other's discount factor.

Rewards are not discounted, but an ego plans for the return discounted by its own gamma: that return
measures it.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from agents import make_ego
from foresight_env.envs import scene_of  # and registers the environments

SEED = 3


def tell(name: str, rewards: list[float], gamma: float, info: dict[str, Any]) -> float:
    """Print both returns and the smallest distance; returns the discounted return."""
    discounted = sum(reward * gamma**t for t, reward in enumerate(rewards))
    print(
        f"{name}: return {discounted:.1f} discounted by the agent's own gamma {gamma:.2f}, "
        f"{sum(rewards):.1f} not discounted, smallest distance {info['min_distance']:.2f} m"
    )
    return discounted


def by_hand() -> float:
    """Accelerate towards the goal, others ignored; returns the discounted return."""
    env = gymnasium.make("foresight/Crosswalk-v0")
    seen, _ = env.reset(seed=SEED)
    gamma = scene_of(env).own(0).gamma
    rewards, done = [], False
    while not done:
        wanted = 4.0 * (seen[-2:] - seen[:2]) - 3.0 * seen[2:4]  # own goal, position, velocity
        action = np.clip(wanted, -10.0, 10.0).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        done = terminated or truncated
    env.close()
    return tell("by hand", rewards, gamma, info)


def by_ego(name: str = "infer-gamma") -> float:
    """The same crossing with a registered ego; returns the discounted return."""
    env = gymnasium.make("foresight/Crosswalk-v0")
    seen, info = env.reset(seed=SEED)
    scene = scene_of(env)
    policy = make_ego(name)
    memory = policy.init(scene, "pedestrian_0")
    rewards, done = [], False
    while not done:
        memory = policy.update(memory, seen, info)
        decision, memory = policy.act(memory)
        seen, reward, terminated, truncated, info = env.step(decision.action)
        rewards.append(float(reward))
        done = terminated or truncated
    env.close()
    found = tell(name, rewards, scene.own(0).gamma, info)
    inferred = ", ".join(f"{mean:.2f} +- {std:.2f}" for mean, std in decision.gammas.values())
    print(f"discount factor of the other: inferred {inferred}, true {info['gamma'][1]:.2f}")
    return found


if __name__ == "__main__":
    by_hand()
    by_ego()
