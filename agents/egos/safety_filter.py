"""Safety filter: the last stage of any ego; it replaces actions after which the ego cannot evade.

An action passes if, after it, some evasive manoeuvre (`manoeuvres`) keeps the ego clear of all
others for some time, whatever these do within a bound of their acceleration (`reachable`).
Otherwise the clear manoeuvre nearest to the action replaces it, or the one with the least
violation if none is clear and it is better than the action by more than noise. A car's action is
taken to follow its plan. While an agent was never observed, all actions pass.

Compare responsibility-sensitive safety (Shalev-Shwartz, Shammah and Shashua, "On a formal model of
safe and scalable self-driving cars", 2017) and predictive safety filters (Wabersich and Zeilinger,
"A predictive safety filter for learning-based control of constrained nonlinear dynamical systems",
Automatica 2021). No guarantee follows: others may exceed the bound, and states are estimates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.manoeuvres import Backup, manoeuvres
from agents.egos.perception import Perception
from agents.egos.reachable import clearances
from agents.interfaces.policy import Decision, EgoPolicy
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.games import Vehicle

CHECK_STEP = 0.05
"""Largest time between checked poses, s."""
LEAST_MARGIN = 0.02
"""Clearance (m) that is always required: poses are checked at discrete times."""
GAIN = 0.005
"""Least difference of weighted violations (m) by which a manoeuvre must be better than the plan, if
none is clear: smaller ones are noise."""


CONTACT = 10.0
"""How much more a violation counts that occurs if the others keep their course: where no manoeuvre
is clear of all that they may do, the ego first avoids what they are about to do."""


class FilterBounds(NamedTuple):
    """Assumptions of the filter, chosen on development seeds of the study `safety`."""

    horizon: float
    """For how long the ego must be able to stay clear, s."""
    acceleration: float
    """With which others may depart from their course, m/s^2."""
    deviations: float
    """Clearance for errors of observed states, in standard deviations of the noise."""


class FilterMemory(NamedTuple):
    """Memory of the filtered policy, and the filter's own perception."""

    policy: Any
    perception: Perception
    backup: Backup = None
    """By which the last decision was found to be safe."""


@dataclass(frozen=True)
class SafetyFilter:
    """Ego policy whose actions pass the safety filter; it has the policy's name."""

    policy: EgoPolicy[Any]
    walking: FilterBounds = FilterBounds(1.0, 1.0, 3.0)
    """For an ego that walks."""
    driving: FilterBounds = FilterBounds(2.0, 1.5, 2.0)
    """For an ego that drives."""

    @property
    def name(self) -> str:
        """Name of the filtered policy."""
        return self.policy.name

    def init(self, scene: Scene, agent: str | int) -> FilterMemory:
        """See `EgoPolicy`."""
        return FilterMemory(self.policy.init(scene, agent), Perception(scene, scene.index(agent)))

    @no_type_check
    def update(
        self,
        memory: FilterMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> FilterMemory:
        """See `EgoPolicy`."""
        check_memory(memory, FilterMemory)
        policy = self.policy.update(memory.policy, observation, info)
        return memory._replace(
            policy=policy, perception=memory.perception.taking(observation, info)
        )

    @no_type_check
    def act(self, memory: FilterMemory) -> tuple[Decision, FilterMemory]:
        """See `EgoPolicy`; `Decision.intervention` says whether the action was replaced."""
        check_memory(memory, FilterMemory)
        decision, policy = self.policy.act(memory.policy)
        perception, backup = memory.perception, None
        if not perception.missing:
            decision, backup = self._filtered(perception, decision, memory.backup)
        return decision, FilterMemory(policy, perception.acted(decision.action), backup)

    def _filtered(
        self, perception: Perception, decision: Decision, backup: Backup
    ) -> tuple[Decision, Backup]:
        """Return the decision or its replacement, and the backup for the next one."""
        scene, ego = perception.scene, perception.ego
        drives = isinstance(scene.game.players[ego].dynamics, Vehicle)
        bounds = self.driving if drives else self.walking
        step = scene.dt / np.ceil(scene.dt / CHECK_STEP)
        times = step * np.arange(1, round(bounds.horizon / step) + 1)
        possible = manoeuvres(scene, ego, perception.states()[ego], decision, times, backup)
        errors = LEAST_MARGIN + bounds.deviations * scene.noise_std
        margin = errors + np.concatenate([possible.now.margin, possible.later.margin])[:, None]
        poses = np.concatenate([possible.now.poses, possible.later.poses])
        clear = clearances(perception, poses, times, bounds.acceleration)
        violation = _violation(clear.worst - margin) + CONTACT * _violation(clear.expected - margin)
        now, later = np.split(violation, [len(possible.controls)])
        least = now.min()
        if later.min() <= 0.0 or (least > 0.0 and later.min() <= least + GAIN):
            return decision, possible.later.backups[int(np.argmin(later))]
        away = np.sum((possible.controls - decision.action) ** 2, axis=1)
        passing = now <= 0.0
        chosen = int(np.argmin(np.where(passing, away, np.inf) if passing.any() else now))
        action = possible.controls[chosen].astype(np.float32)
        replaced = replace(decision, action=action, intervention=True)
        return replaced, possible.now.backups[chosen]


def _violation(clearance: Float[np.ndarray, "M T"]) -> Float[np.ndarray, "M"]:
    """Mean depth over the times, m; 0 where the motion stays clear."""
    found: Float[np.ndarray, "M"] = -np.minimum(clearance, 0.0).mean(axis=1)
    return found
