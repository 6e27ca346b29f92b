"""`foresight train ppo`: an ego that learns by trying, with Stable-Baselines3.

It walks among oracles that follow their open-loop equilibria, many crosswalks at a time. An epoch
is one rollout of all environments from new initial states and the updates from it. Random numbers
are seeded per epoch, so an interrupted training resumes from its weights alone, with the same
result.

This module needs the extra `rl`; nothing else does.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

from agents.learned.crosswalk_window import SIZE, WINDOW, crosswalk_window
from agents.learned.policy_network import SCALE, WIDTH, policy_network
from agents.learned.training import Checkpoint, Epoch, Schedule, Trained, is_tired
from evaluation.training import names
from evaluation.training.generation import FIRST_SEED
from evaluation.training.trained import write_trained
from foresight_env.envs.crosswalk.vector import CrosswalkVectorEnv
from foresight_env.extras import require
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT, Ranges

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    require("rl", "evaluation.training.reinforcement")
    raise

ENVS = 256
STEPS = 60
"""Of an epoch, of each environment, and most of an episode."""
JUDGED = 64
"""Episodes of validation; the same in every epoch."""
PENALTY = 100.0
"""For a collision, which ends an episode and with it all later costs: more than those are."""
REWARD_SCALE = 0.05
"""Of rewards in training: sums are to be near 1, which its value network learns faster."""
DISCOUNT = 0.97
UPDATES = 10
"""Passes through a rollout."""


class Crosswalks(VecEnv):
    """Our vector environment in the form of Stable-Baselines3.

    Observations are windows, actions are between -1 and 1.
    """

    def __init__(self, count: int, steps: int, ranges: Ranges = Ranges()) -> None:
        self._env = CrosswalkVectorEnv(
            count,
            behaviour="open_loop",
            max_steps=steps,
            ranges=ranges,
            autoreset_mode=AutoresetMode.SAME_STEP,
        )
        self._first = 0
        self.earned = 0.0
        """Rewards of all since the last `reset`."""
        self.begun = 0
        """Episodes since then, the last ones of which may not have ended."""
        self._rows = np.zeros((count, WINDOW, SIZE))
        self._actions = np.zeros((count, 2), np.float32)
        self.render_mode = None
        limit = np.full(WINDOW * SIZE, np.inf, np.float32)
        actions = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        super().__init__(count, gymnasium.spaces.Box(-limit, limit), actions)

    def begin_with(self, seed: int) -> None:
        """Seed of the first environment's next episode; the others' follow it."""
        self._first = seed

    def reset(self) -> np.ndarray:
        """Begin all episodes."""
        seen, _ = self._env.reset(seed=self._first)
        self._rows[:] = seen[:, None]
        self.earned, self.begun = 0.0, self.num_envs
        return self._windows(self._rows)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep actions for `step_wait`."""
        self._actions = np.asarray(CONTROL_LIMIT * actions, np.float32)

    def step_wait(self) -> Any:
        """Observations, rewards, ends, and information."""
        seen, rewards, terminated, truncated, infos = self._env.step(self._actions)
        over = terminated | truncated
        episode_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        last = self._rows.copy()
        self._rows = np.concatenate([self._rows[:, 1:], seen[:, None]], axis=1)
        if over.any():
            final = infos["final_info"]
            rewards -= PENALTY * (final["collision"] & over)
            for k in np.flatnonzero(over):
                rows = np.concatenate([last[k, 1:], infos["final_obs"][k][None]])
                episode_infos[k] = {
                    "terminal_observation": self._windows(rows[None])[0],
                    "TimeLimit.truncated": bool(truncated[k]),
                }
                self._rows[k] = seen[k]
        self.earned += float(rewards.sum())
        self.begun += int(over.sum())
        return self._windows(self._rows), np.float32(REWARD_SCALE * rewards), over, episode_infos

    def _windows(self, rows: np.ndarray) -> np.ndarray:
        return SCALE * crosswalk_window(rows).reshape(len(rows), -1)

    def close(self) -> None:
        """There is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same of all."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: these environments are one."""
        raise AttributeError(f"{attr_name}: cannot be set of many crosswalks at once")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused: these environments are one."""
        raise AttributeError(f"{method_name}: is no method of many crosswalks at once")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """They are not."""
        return [False] * self.num_envs


def reinforce(
    folder: Path,
    schedule: Schedule,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    *,
    envs: int = ENVS,
    steps: int = STEPS,
    judged: int = JUDGED,
) -> Trained:
    """Train, and write weights and curve in `folder`; go on where a training was left there.

    `schedule.batch` are steps per update. Losses are minus the mean reward per episode: in
    training of what was tried, in validation of what the network thinks best.
    """
    begin = time.perf_counter()
    torch.set_num_threads(1)  # sums in another order are other sums
    training, validating = Crosswalks(envs, steps), Crosswalks(judged, steps)
    model = PPO(
        "MlpPolicy",
        training,
        n_steps=steps,
        batch_size=schedule.batch,
        n_epochs=UPDATES,
        gamma=DISCOUNT,
        learning_rate=schedule.rate,
        policy_kwargs={
            "net_arch": [WIDTH, WIDTH],
            "log_std_init": -1.0,
            "optimizer_class": torch.optim.AdamW,
            "optimizer_kwargs": {"weight_decay": schedule.decay, "eps": 1e-5},
        },
        seed=schedule.seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))
    about = {
        "schedule": asdict(schedule),
        "data": {"envs": envs, "steps": steps, "judged": judged, "penalty": PENALTY},
    }
    checkpoint = Checkpoint(folder, about)
    blank = {"model": _arrays(model), "best": _actor(model)}
    state, curve = checkpoint.load(blank)
    best = state["best"]
    if curve:
        _restore(model, state["model"])
    while len(curve) < schedule.epochs and not is_tired(curve, schedule.patience):
        number = len(curve)
        value = _epoch(model, training, number, schedule)
        found = _judge(model, validating)
        if not curve or found < min(e.validation for e in curve):
            best = _actor(model)
        curve = (*curve, Epoch(number, value, found))
        checkpoint.save({"model": _arrays(model), "best": best}, curve)
        on_epoch(curve[-1])
    network = policy_network({name: np.asarray(v) for name, v in best.items()})
    trained = Trained(network, curve, min(curve, key=lambda e: e.validation).number)
    taken = {"network": names.PPO, "steps": len(curve) * envs * steps}
    write_trained(folder, names.PPO, trained, taken, time.perf_counter() - begin)
    return trained


def _epoch(model: PPO, training: Crosswalks, number: int, schedule: Schedule) -> float:
    """One rollout and its updates; minus the mean reward per episode."""
    source = np.random.default_rng([schedule.seed, number])
    model.set_random_seed(int(source.integers(2**31)))
    seeds = FIRST_SEED["validation"] - FIRST_SEED["train"] - training.num_envs
    training.begin_with(FIRST_SEED["train"] + int(source.integers(seeds)))
    rate = schedule.rate * (1.0 - number / schedule.epochs)
    model.lr_schedule = lambda _: rate
    model.learn(model.n_steps * training.num_envs)
    return -training.earned / training.begun


def _judge(model: PPO, validating: Crosswalks) -> float:
    """Minus the mean reward of episodes that are the same every time."""
    validating.begin_with(FIRST_SEED["validation"])
    seen: Any = validating.reset()
    live, total = np.ones(validating.num_envs, bool), np.zeros(validating.num_envs)
    while live.any():
        actions, _ = model.predict(seen, deterministic=True)
        seen, rewards, over, _ = validating.step(actions)
        total += live * rewards / REWARD_SCALE
        live &= ~over
    return -float(total.mean())


def _actor(model: PPO) -> dict[str, Any]:
    return {name: jnp.asarray(v.numpy().copy()) for name, v in model.policy.state_dict().items()}


def _arrays(model: PPO) -> dict[str, Any]:
    """Weights and the optimiser's moments: the state from which an epoch continues."""
    optimiser: Any = model.policy.optimizer
    moments = {}
    for k, weight in enumerate(_weights(model)):
        blank = {"step": torch.zeros(()), "exp_avg": 0.0 * weight, "exp_avg_sq": 0.0 * weight}
        for name, value in (optimiser.state.get(weight) or blank).items():
            moments[f"{k}.{name}"] = jnp.asarray(value.detach().numpy().copy())
    return {"policy": _actor(model), "moments": moments}


def _restore(model: PPO, arrays: dict[str, Any]) -> None:
    def tensor(value: Any) -> torch.Tensor:
        return torch.from_numpy(np.array(value))

    policy = {name: tensor(v) for name, v in arrays["policy"].items()}
    model.policy.load_state_dict(policy)
    optimiser: Any = model.policy.optimizer
    for k, weight in enumerate(_weights(model)):
        for name in ("step", "exp_avg", "exp_avg_sq"):
            optimiser.state[weight][name] = tensor(arrays["moments"][f"{k}.{name}"])


def _weights(model: PPO) -> list[torch.Tensor]:
    groups: Any = model.policy.optimizer.param_groups
    return [weight for group in groups for weight in group["params"]]
