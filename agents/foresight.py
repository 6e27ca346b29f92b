"""The foresight ego: infers the others' goals and discount factors on its way, and plans with them.

With `infer_gamma=False` it is the baseline that takes everybody for farsighted (gamma = 1): the
same estimator, observations and planner, one assumption more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.constant_velocity import ConstantVelocity, ConstantVelocityMemory
from agents.motion import fit_constant_velocity, player_positions
from agents.planning import Plan, plan_equilibrium
from agents.policy import Decision
from foresight_env.envs.scene import Scene
from foresight_env.games import Vehicle
from foresight_env.inverse import Free, OnlineEstimator, OnlineState, Prior

LEAST_VARIANCE = 1e-6
"""Variance (m^2) that noise-free observations are given: equilibria are not exact models."""


class ForesightMemory(NamedTuple):
    """Estimator, what it knows, and the last plan."""

    scene: Scene
    ego: int
    estimator: OnlineEstimator
    state: OnlineState | None
    plan: Plan | None
    early: ConstantVelocityMemory
    """What to do until there is an estimate."""
    stale: bool = False
    """Whether the latest update kept the estimate before it."""


@dataclass(frozen=True)
class Foresight:
    """Estimate, then play the equilibrium of the estimated game."""

    name: str = "foresight"
    infer_gamma: bool = True
    window: int = 10
    """Observations that each estimate uses."""
    aging: float = 1.5
    """See `OnlineEstimator`: the others replan at every step, and the ego has not played the
    equilibrium that its old estimates stood for. Chosen on seeds 12 to 70 of the closed-loop study:
    90 % intervals of gamma cover 45 % of the truths with 1, 70 % with 1.3, 76 % with 1.6."""
    ahead: int = 15
    """Stages after the window in the estimated game."""
    prior: Prior = Prior(gamma_weight=4.0, gamma_center=1.0, theta_deviation=(("goal", 3.0),))
    """Weak beliefs: discount factors 1 +- 0.5, goals within a few metres of the first guess."""

    def init(self, scene: Scene, agent: str | int) -> ForesightMemory:
        """See `EgoPolicy`."""
        ego = scene.index(agent)
        if any(isinstance(player.dynamics, Vehicle) for player in scene.game.players):
            raise ValueError(
                f"scene: has cars, whose paths the ego {self.name!r} cannot infer yet; use "
                "'oracle' or 'constant-velocity' there"
            )
        free = tuple(
            Free((), False, True) if j == ego else Free(("goal",), self.infer_gamma, True)
            for j in range(scene.players)
        )
        estimator = OnlineEstimator(
            replace(scene.game, horizon=self.window - 1 + self.ahead),
            scene.observation_model(ego),
            free,
            max(scene.noise_std**2, LEAST_VARIANCE),
            self.window,
            self.prior,
            aging=self.aging,
        )
        return ForesightMemory(
            scene, ego, estimator, None, None, ConstantVelocity().init(scene, agent)
        )

    def update(
        self,
        memory: ForesightMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> ForesightMemory:
        """See `EgoPolicy`."""
        seen = np.asarray(observation[:-2], dtype=float)
        state = memory.state
        if state is None:
            state = memory.estimator.init(*self._first_guess(memory.scene, memory.ego, seen))
        early = ConstantVelocity().update(memory.early, observation, info)
        following = memory.estimator.update(state, seen)
        stale = following.failures > state.failures
        return memory._replace(state=following, early=early, stale=stale)

    def _first_guess(
        self, scene: Scene, ego: int, seen: Float[np.ndarray, "size"]
    ) -> tuple[list[dict[str, Any]], Float[np.ndarray, "N"]]:
        """Own parameters as they are; others share the weights and wish to stay where they are."""
        own = scene.own(ego)
        model = scene.observation_model(ego)
        theta, gamma = [], np.ones(scene.players)
        for j in range(scene.players):
            place, _ = fit_constant_velocity(player_positions(model, seen[None], j), scene.dt)
            theta.append(own.theta if j == ego else {**own.theta, "goal": place})
        gamma[ego] = own.gamma
        if self.infer_gamma:
            gamma[np.arange(scene.players) != ego] = 0.8
        return theta, gamma

    def act(self, memory: ForesightMemory) -> tuple[Decision, ForesightMemory]:
        """See `EgoPolicy`."""
        scene, ego, state = memory.scene, memory.ego, memory.state
        if state is None or state.estimate is None or state.present is None:
            decision, early = ConstantVelocity().act(memory.early)
            return replace(decision, predicted={}), memory._replace(early=early)
        found = state.estimate
        spread = state.gamma_deviation
        gammas = {
            j: (float(found.gamma[j]), float(spread[j])) for j in range(scene.players) if j != ego
        }
        ahead = [
            np.concatenate([u[state.stage :], np.zeros((scene.game.horizon, u.shape[1]))])
            for u in found.solution.controls
        ]
        controls = [u[: scene.game.horizon] for u in ahead]
        decision, plan = plan_equilibrium(
            scene,
            ego,
            state.present,
            found.theta,
            found.gamma,
            memory.plan,
            gammas,
            [controls, None],
        )
        return replace(decision, stale=memory.stale), memory._replace(plan=plan)


def farsighted() -> Foresight:
    """The gamma = 1 baseline."""
    return Foresight("farsighted", infer_gamma=False)
