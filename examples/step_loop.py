"""Drive a pedestrian among others: `python examples/step_loop.py`.

First the ten lines that every Gymnasium user knows, with a hand-written policy; then the same
crossing with one of the registered egos, which infers the other's foresight on the way.
"""

from __future__ import annotations

import gymnasium
import numpy as np

import foresight_env.envs  # noqa: F401  (registers the environments)
from agents import make_ego

SEED = 3


def by_hand() -> float:
    """Accelerate towards the goal, whoever stands there; returns the sum of rewards."""
    env = gymnasium.make("foresight/Crosswalk-v0")
    seen, _ = env.reset(seed=SEED)
    total, done = 0.0, False
    while not done:
        wanted = 4.0 * (seen[-2:] - seen[:2]) - 3.0 * seen[2:4]  # own goal, position, velocity
        action = np.clip(wanted, -10.0, 10.0).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(action)
        total, done = total + float(reward), terminated or truncated
    env.close()
    print(f"by hand: return {total:.1f}, smallest distance {info['min_distance']:.2f} m")
    return total


def by_ego(name: str = "foresight") -> float:
    """The same crossing, driven by a registered ego; returns the sum of rewards."""
    env = gymnasium.make("foresight/Crosswalk-v0")
    seen, info = env.reset(seed=SEED)
    policy = make_ego(name)
    memory = policy.init(env.unwrapped.scene, "pedestrian_0")  # type: ignore[attr-defined]
    total, done = 0.0, False
    while not done:
        memory = policy.update(memory, seen, info)
        decision, memory = policy.act(memory)
        seen, reward, terminated, truncated, info = env.step(decision.action)
        total, done = total + float(reward), terminated or truncated
    env.close()
    inferred = ", ".join(f"{mean:.2f} +- {std:.2f}" for mean, std in decision.gammas.values())
    print(f"{name}: return {total:.1f}, smallest distance {info['min_distance']:.2f} m")
    print(f"discount factor of the other: inferred {inferred}, true {info['gamma'][1]:.2f}")
    return total


if __name__ == "__main__":
    by_hand()
    by_ego()
