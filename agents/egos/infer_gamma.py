"""The ego `infer-gamma`: infers the others' goals and discount factors, and plans with them.

With `infer_gamma=False` it is the baseline `assume-gamma-1`, with the others' discount factors
fixed at 1: the same estimator, observations and planner. With `true_gamma=True` it is the reference
`know-gamma`, with them fixed at their true values: its gain over `assume-gamma-1` is the value
of knowing the discount factors, and nothing else, to this ego.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.egos.checks import check_memory
from agents.egos.hypotheses import Hypotheses, HypothesesMemory, Others
from agents.egos.motion import player_positions, present_state
from agents.egos.own_state import observation_variance
from agents.egos.perception import Perception
from agents.egos.planning import ALTERNATIVE_STEPS, Plan, needs_longer_plan, plan_equilibrium
from agents.egos.predict_then_plan import PlanMemory, constant_velocity
from agents.interfaces.policy import Decision
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.equilibrium import Budget
from foresight_env.inverse import (
    Estimate,
    Free,
    MovingHorizonEstimator,
    MovingHorizonState,
    Prior,
    UpdatePhase,
)

AHEAD_PART = 0.6
"""Of the planning horizon, how much the estimated game looks ahead."""


class InferGammaMemory(NamedTuple):
    """Estimator with its state, and the last plan."""

    scene: Scene
    ego: int
    estimator: MovingHorizonEstimator
    state: MovingHorizonState | None
    plan: Plan | None
    early: PlanMemory
    """Policy until there is an estimate; its perception has the ego's own state."""
    outdated: bool = False
    """Whether the latest update kept the estimate before it."""
    planning: Budget = Budget.offline()
    """Budget of the plan after the latest update."""
    hypotheses: HypothesesMemory = HypothesesMemory()


@dataclass(frozen=True)
class InferGamma:
    """Estimate, then play the equilibrium of the estimated game."""

    name: str = "infer-gamma"
    infer_gamma: bool = True
    true_gamma: bool = False
    """Whether the others' discount factors are taken from the environment's information; needs
    `infer_gamma=False`."""
    window: int = 10
    """Observations that each estimate uses."""
    forgetting_factor: float = 1.5
    """See `MovingHorizonEstimator`: the others replan at every step, and the ego has not played the
    equilibrium that its old estimates stood for. Chosen on seeds 12 to 70 of the closed-loop study:
    90 % intervals of gamma cover 45 % of the truths with 1, 70 % with 1.3, 76 % with 1.6."""
    budget: Budget | None = None
    """Of the estimator's updates; None: `Budget.realtime()` where more than two play, whose games
    take long, else `Budget.online()`."""
    ahead: int | None = None
    """Stages after the window in the estimated game; None: three fifths of the planning horizon."""
    prior: Prior = Prior(gamma_weight=4.0, gamma_center=1.0)
    """Of discount factors: weak, 1 +- 0.5. Of `theta`: `scene.opponent_prior` unless given here."""

    hypotheses: Hypotheses = Hypotheses()
    """Hypotheses that a longer plan is for where the game's horizon is short; the equilibrium is
    one of them."""

    def __post_init__(self) -> None:
        if self.infer_gamma and self.true_gamma:
            raise ValueError(
                "true_gamma: is True with infer_gamma=True; discount factors are inferred or known"
            )

    def init(self, scene: Scene, agent: str | int) -> InferGammaMemory:
        """See `EgoPolicy`."""
        ego = scene.index(agent)
        free = tuple(
            Free((), False, True)
            if j == ego
            else Free(scene.opponent_prior.free, self.infer_gamma, True)
            for j in range(scene.players)
        )
        usual = Budget.realtime() if scene.players > 2 else Budget.online()
        budget = usual if self.budget is None else self.budget
        ahead = max(1, round(AHEAD_PART * scene.game.horizon)) if self.ahead is None else self.ahead
        estimator = MovingHorizonEstimator(
            replace(scene.game, horizon=self.window - 1 + ahead),
            scene.observation_model(ego),
            free,
            observation_variance(scene),
            self.window,
            replace(
                self.prior,
                theta_deviation=self.prior.theta_deviation or scene.opponent_prior.deviation,
            ),
            forgetting_factor=self.forgetting_factor,
            starts=1 if budget.single_game else MovingHorizonEstimator.starts,
            budget=budget,
        )
        early = constant_velocity().init(scene, agent)
        return InferGammaMemory(scene, ego, estimator, None, None, early)

    @no_type_check
    def update(
        self,
        memory: InferGammaMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> InferGammaMemory:
        """See `EgoPolicy`."""
        check_memory(memory, InferGammaMemory)
        scene, state = memory.scene, memory.state
        early = constant_velocity().update(memory.early, observation, info)
        if early.perception.missing:
            return memory._replace(early=early)
        seen = np.asarray(observation[:-2], dtype=float)
        recent = np.stack([*(() if state is None else state.observations), seen])
        guessed = self._guess(early.perception, recent[-self.window :])
        if state is None:
            gamma = np.full(scene.players, 0.8 if self.infer_gamma else 1.0)
            if self.true_gamma:
                gamma = np.array(_true_gamma(info), dtype=float)
            gamma[memory.ego] = scene.own(memory.ego).gamma
            state = memory.estimator.init(guessed, gamma)
        else:
            # Parameters that are not estimated are guessed again, such as a car's path.
            kept = scene.opponent_prior.free
            state = state._replace(
                theta=tuple(
                    {**new, **{name: old[name] for name in kept}}
                    for new, old in zip(guessed, state.theta, strict=True)
                )
            )
        following = memory.estimator.update(state, seen)
        outdated = following.failures > state.failures
        found = following.estimate
        long = found is not None and int(found.num_newton_steps) > ALTERNATIVE_STEPS
        late = outdated or long or state.phase is not UpdatePhase.TRACKING
        hurries = memory.estimator.budget.single_game and late
        planning = Budget.trial() if hurries else Budget.offline()
        return memory._replace(state=following, early=early, outdated=outdated, planning=planning)

    def _guess(
        self, perception: Perception, recent: Float[np.ndarray, "K size"]
    ) -> list[dict[str, Any]]:
        """Own parameters as they are; others' by the opponent prior."""
        scene, ego = perception.scene, perception.ego
        own = scene.own(ego)
        model = scene.observation_model(ego)
        found = []
        for j, player in enumerate(scene.game.players):
            if j == ego:
                found.append(own.theta)
                continue
            track = player_positions(model, recent, j)
            track = track[~np.isnan(track).any(axis=1)]
            if len(track):
                state = present_state(player.dynamics, model, recent, j, scene.dt)
            else:  # out of sight for long
                state = perception.states()[j]
                track = state[None, :2]
            found.append(scene.opponent_prior.guess(own.theta, track, state))
        return found

    @no_type_check
    def act(self, memory: InferGammaMemory) -> tuple[Decision, InferGammaMemory]:
        """See `EgoPolicy`."""
        check_memory(memory, InferGammaMemory)
        scene, ego, state = memory.scene, memory.ego, memory.state
        if state is None or state.estimate is None or state.present is None:
            decision, early = constant_velocity().act(memory.early)
            return replace(decision, predicted={}), memory._replace(early=early)
        perception = memory.early.perception
        present = list(state.present)
        if perception.own.mean is not None:
            present[ego] = perception.own.mean
        found = state.estimate
        spread = state.gamma_deviation
        gammas = {
            j: (float(found.gamma[j]), float(spread[j])) for j in range(scene.players) if j != ego
        }
        # Where the last plan leads, the estimate's own future leads as well (to one equilibrium in
        # 98 of 100 decisions at crossings and left turns), so it is for the first plan alone.
        future = [] if memory.plan is not None else [_future(scene, state, found)]
        longer = needs_longer_plan(scene, ego, present[ego])
        decision, plan = plan_equilibrium(
            scene,
            ego,
            present,
            found.theta,
            found.gamma,
            memory.plan,
            gammas,
            [*future, None],
            # One equilibrium is enough where it is but a hypothesis.
            budget=Budget.trial() if longer else memory.planning,
        )
        hypotheses = HypothesesMemory()
        if longer:
            decision, hypotheses = self.hypotheses.plan(
                scene,
                ego,
                Others(present, found.theta, perception.states()),
                None if plan is None or decision.plan_fallback else plan.solution,
                decision,
                memory.hypotheses,
            )
        early = memory.early._replace(perception=perception.acted(decision.action))
        return replace(decision, estimate_outdated=memory.outdated), memory._replace(
            plan=plan, early=early, hypotheses=hypotheses
        )


def _future(
    scene: Scene, state: MovingHorizonState, found: Estimate
) -> list[Float[np.ndarray, "T _"]]:
    """All players' controls from now on in the estimated game, (horizon, m_i) each.

    Zero after its end.
    """
    horizon = scene.game.horizon
    return [
        np.concatenate([u[state.stage :], np.zeros((horizon, u.shape[1]))])[:horizon]
        for u in found.solution.controls
    ]


def _true_gamma(info: Mapping[str, Any]) -> Float[np.ndarray, "N"]:
    if info.get("gamma") is None:
        raise ValueError("info: holds no 'gamma'; know-gamma needs the environment's information")
    found: Float[np.ndarray, "N"] = info["gamma"]
    return found


def know_gamma() -> InferGamma:
    """Return the reference ego `know-gamma`, which sees the others' true discount factors."""
    return InferGamma("know-gamma", infer_gamma=False, true_gamma=True)


def assume_gamma_1() -> InferGamma:
    """Return the baseline ego `assume-gamma-1`."""
    return InferGamma("assume-gamma-1", infer_gamma=False)
