"""One closed-loop episode of an ego: its steps, and what every study reads off them.

The ego is the one agent that the environment leaves to be controlled, with a known discount factor;
the others play the equilibrium of the true game at every step, with hidden discount factors.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents import Decision, make_ego
from agents.egos.safety_filter import SafetyFilter
from evaluation.execution.compilation import until_forgotten
from evaluation.rollout.setting import EGO_GAMMA, RunSetting
from evaluation.rollout.surprises import observed
from foresight_env.envs.core.scene import Scene, observation_order

KNOWING = ("oracle", "know-gamma", "assume-gamma-1")
"""Egos that know or assume the discount factors in their decisions; others infer them."""
WARM_UP_STEPS = 13
"""Steps after which every program that an ego needs has been compiled: the window slides."""


class Step(NamedTuple):
    """One step of an episode."""

    state: Float[np.ndarray, "N 4"]
    observation: Float[np.ndarray, "size"]
    decision: Decision
    latency: float
    """Seconds for update and decision."""
    info: dict[str, Any]
    """As the environment returned it after the step, with the ego's `reward`."""


class Episode(NamedTuple):
    """A finished episode."""

    steps: tuple[Step, ...]
    scene: Scene

    @property
    def dt(self) -> float:
        """Duration of a step, s."""
        return self.scene.dt

    @property
    def time_limit(self) -> float:
        """Time after which the environment truncates, s."""
        return self.scene.max_steps * self.scene.dt

    @property
    def last(self) -> dict[str, Any]:
        """The environment's `info` at the end."""
        return self.steps[-1].info

    @property
    def states(self) -> Float[np.ndarray, "stages N 4"]:
        """True states of all players, the last one included."""
        return np.stack([*(s.state for s in self.steps), self.last["state"]])

    @property
    def cost(self) -> float:
        """The ego's undiscounted cost, integrated over time."""
        return -float(sum(s.info["reward"] for s in self.steps)) * self.dt

    @property
    def latencies(self) -> list[float]:
        """Milliseconds per decision."""
        return [1e3 * s.latency for s in self.steps]

    @property
    def counts(self) -> dict[str, int]:
        """Failed plans and fits of the ego, interventions of its filter, others' failed solves."""
        return {
            "failed_plans": sum(s.decision.plan_fallback for s in self.steps),
            "interventions": sum(s.decision.intervention for s in self.steps),
            "failed_fits": sum(s.decision.estimate_outdated for s in self.steps),
            "oracle_failures": int(self.last["solver_failures"]),
        }


def inferred(ego: str, decision: Decision) -> dict[int, tuple[float, float]]:
    """Means and deviations of the discount factors that an ego's decision inferred."""
    return {} if ego in KNOWING else dict(decision.gammas)


def begin_episode(
    env: Any, seed: int, gammas: tuple[float, float]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reset `env` to an episode's first instant; returns its observations and information.

    The ego's discount factor is `EGO_GAMMA`, the others' are drawn uniformly between `gammas`.
    """
    hidden = np.random.default_rng([seed, 1]).uniform(*gammas, env.scene.players)
    hidden[env.scene.controlled[0]] = EGO_GAMMA
    found: tuple[dict[str, Any], dict[str, Any]] = env.reset(seed=seed, options={"gamma": hidden})
    return found


def episode(env: Any, setting: RunSetting, ego: str, seed: int) -> Iterator[Step]:
    """Run one episode of the setting's `env` with a registered ego, step by step.

    The ego is the one agent that `env` leaves to be controlled; the others' gammas are drawn.
    """
    policy = make_ego(ego)
    policy = SafetyFilter(policy) if setting.safety_filter else policy
    observations, infos = begin_episode(env, seed, setting.gammas)
    agent = env.agents[0]
    memory = policy.init(env.scene, agent)
    random = np.random.default_rng([seed, 3])
    while env.agents:
        state = infos[agent]["state"]
        seen = observed(
            setting.surprise, random, observations[agent], env.scene.players, env.scene.noise_std
        )
        begin = time.perf_counter()
        memory = policy.update(memory, seen, infos[agent])
        decision, memory = policy.act(memory)
        latency = time.perf_counter() - begin
        observations, rewards, _, _, infos = env.step({agent: decision.action})
        yield Step(
            state, seen, decision, latency, {**infos[agent], "reward": float(rewards[agent])}
        )


def run_episode(setting: RunSetting, ego: str, seed: int, env: Any = None) -> Episode:
    """Run one episode to its end, in `env` where the caller has made the setting's environment."""
    env = setting.make() if env is None else env
    steps = tuple(episode(env, setting, ego, seed))
    return Episode(steps, env.scene)


@until_forgotten
def warm_up(setting: RunSetting, ego: str) -> None:
    """Compile in this process what an episode needs, so that latencies are those of running."""
    for _ in islice(episode(setting.make(), setting, ego, 0), WARM_UP_STEPS):
        pass


def observed_states(
    observations: Float[np.ndarray, "K _"], ego: int, players: int, width: int = 4
) -> Float[np.ndarray, "K players width"]:
    """The ego's observation of every player, by index; `width`: observed entries of a state."""
    found = np.empty((len(observations), players, width))
    order = list(observation_order(ego, players))
    found[:, order] = observations[:, : players * width].reshape(-1, players, width)
    return found
