"""Ego policies: explicit state, three functions.

    memory = policy.init(scene, agent)
    memory = policy.update(memory, observation, info)   # once per step, before acting
    decision, memory = policy.act(memory)               # decision.action goes to env.step

A policy is a stateless setting; everything that changes is in `memory`, so one
policy may control several agents. Observations and actions are NumPy arrays as the environment
defines them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float

from foresight_env.envs.core.scene import Scene

Memory = TypeVar("Memory")


class Hypothesis(NamedTuple):
    """One of several possibilities of what the others do."""

    name: str
    weight: float
    """Probability that the ego plans with; those of a decision add up to 1."""
    predicted: Mapping[int, Float[np.ndarray, "K 2"]]
    """Others' positions by player, m."""


@dataclass(frozen=True)
class Decision:
    """An action, with the plan, predictions and estimates behind it."""

    action: Float[np.ndarray, "m"]
    planned: Float[np.ndarray, "K 2"] | None = None
    """Own positions that the plan passes, m."""
    predicted: Mapping[int, Float[np.ndarray, "K 2"]] = field(default_factory=dict)
    """Others' predicted positions by player, m."""
    gammas: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """Inferred discount factors by player: mean and standard deviation."""
    plan_fallback: bool = False
    """Whether a solve failed and the action is a fallback: the last plan continued, or braking."""
    estimate_outdated: bool = False
    """Whether the latest fit failed, so that an older estimate was planned with."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """Possibilities that the plan is for, where there are several; `predicted` is that of the most
    likely."""
    intervention: bool = False
    """Whether the safety filter replaced the policy's action (`agents.egos.safety_filter`)."""


@runtime_checkable
class EgoPolicy(Protocol[Memory]):
    """Policy of a controlled agent."""

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        ...

    def init(self, scene: Scene, agent: str | int) -> Memory:
        """Memory at the start of an episode."""
        ...

    def update(
        self, memory: Memory, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]
    ) -> Memory:
        """Take in the latest observation.

        Only an oracle may look at the truth about others in `info`. `scene.check_episode` finds
        whether `observation` and `info` are of the scene's episode.

        Raises:
            ValueError: the observation has another shape, or is another episode's.
        """
        ...

    def act(self, memory: Memory) -> tuple[Decision, Memory]:
        """Choose an action."""
        ...
