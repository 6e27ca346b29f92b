"""Train with Stable-Baselines3: `python examples/train_sb3.py` (needs the extra `rl`).

The Gymnasium id as it is, in the trainer's own vector of environments. At this size it learns to
start walking, no more; `foresight train ppo` is the ego of the benchmark, trained on the compiled
form of the same environment.
"""

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import foresight_env.envs  # noqa: F401  (registers the environments)

ARGUMENTS = {"behaviour": "open_loop", "max_steps": 30, "planning_horizon": 10}


def make() -> gymnasium.Env[np.ndarray, np.ndarray]:
    """A crosswalk whose actions lie between -1 and 1."""
    env = gymnasium.make("foresight/Crosswalk-v0", **ARGUMENTS)
    return gymnasium.wrappers.RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def main(steps: int = 4096, judged: int = 5) -> tuple[float, float]:
    """Mean returns before and after training."""
    check_env(make(), warn=True)
    env = make_vec_env(make, n_envs=2, seed=0)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=64, gamma=0.95, seed=0, device="cpu")
    watched = make_vec_env(make, n_envs=1, seed=1000)
    before, _ = evaluate_policy(model, watched, judged)
    model.learn(steps)
    after, _ = evaluate_policy(model, watched, judged)
    env.close()
    watched.close()
    print(f"mean return {before:.1f} before, {after:.1f} after {steps} steps")
    return float(before), float(after)


if __name__ == "__main__":
    main()
