"""Predict then plan: any predictor's forecast, and the common planner.

The others follow their forecast whatever the ego does, and the ego plans its best response to it in
the scene's game. Egos of this kind differ in their forecasts only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from agents.egos.checks import check_memory
from agents.egos.perception import Perception
from agents.egos.planning import FULL_GAMMA, Plan, looking_ahead, needs_longer_plan, plan_response
from agents.interfaces.policy import Decision
from agents.interfaces.predictor import Context, Forecast, History, Predictor, SceneGame
from agents.predictors.kinematic import ConstantVelocityPredictor
from foresight_env.annotations import no_type_check
from foresight_env.envs.core.scene import Scene
from foresight_env.games import Dynamics, Vehicle
from foresight_env.games.motion import moving_state, planar_velocity

SMALL = 1e-6
"""Distance (m) below which there is no direction."""


class PlanMemory(NamedTuple):
    """Perception, recent tracks of all agents, and the last plan."""

    perception: Perception
    track: tuple[Float[np.ndarray, "N 4"], ...] = ()
    """Latest states of all agents, the newest last."""
    plan: Plan | None = None


@dataclass(frozen=True)
class PredictThenPlan:
    """The planner with this predictor's forecasts of the others."""

    predictor: Predictor = field(default_factory=ConstantVelocityPredictor)
    name: str = "constant-velocity"
    window: int = 10
    """Steps of the predictor's history."""
    risk: float = 0.1
    """Of a forecast with covariances: probability that another agent is nearer to the plan than
    the ego plans for, at each step."""

    def init(self, scene: Scene, agent: str | int) -> PlanMemory:
        """See `EgoPolicy`."""
        return PlanMemory(Perception(scene, scene.index(agent)))

    @no_type_check
    def update(
        self,
        memory: PlanMemory,
        observation: Float[np.ndarray, "size"],
        info: Mapping[str, Any],
    ) -> PlanMemory:
        """See `EgoPolicy`."""
        check_memory(memory, PlanMemory)
        memory.perception.scene.check_episode(memory.perception.ego, observation, info)
        perception = memory.perception.taking(observation, info)
        if perception.missing:
            return memory._replace(perception=perception)
        # A single position says nothing of velocities: that state is forgotten with the next one.
        known = () if memory.perception.guessed else memory.track
        track = (*known, np.stack(perception.states()))[-self.window :]
        return memory._replace(perception=perception, track=track)

    @no_type_check
    def act(self, memory: PlanMemory) -> tuple[Decision, PlanMemory]:
        """See `EgoPolicy`."""
        check_memory(memory, PlanMemory)
        scene, ego = memory.perception.scene, memory.perception.ego
        if memory.perception.missing:
            decision, perception = memory.perception.waiting()
            return decision, memory._replace(perception=perception)
        states = memory.perception.states()
        mine = scene.own(ego)
        own_gamma = mine.gamma
        if needs_longer_plan(scene, ego, states[ego]):
            scene, own_gamma = looking_ahead(scene), FULL_GAMMA
        horizon = scene.game.horizon
        forecast = self.predictor.predict(history_of(scene, memory.track), horizon)
        own = planned_positions(scene, ego, states[ego], memory.plan)
        places = feared_positions(forecast, ego, own, float(norm.ppf(1.0 - self.risk)))
        predicted = {
            j: states_along(player.dynamics, states[j], places[:, j], scene.dt)
            for j, player in enumerate(scene.game.players)
            if j != ego
        }
        decision, plan = plan_response(
            scene, ego, states[ego], mine.theta, own_gamma, predicted, memory.plan
        )
        most_likely = forecast.most_likely
        decision = replace(
            decision,
            predicted={j: most_likely[:, j] for j in predicted},
            gammas=_gammas(forecast, ego),
            estimate_outdated=forecast.fallback,
        )
        perception = memory.perception.acted(decision.action)
        return decision, memory._replace(perception=perception, plan=plan)


def constant_velocity() -> PredictThenPlan:
    """The classical ego: others keep their velocity."""
    return PredictThenPlan()


def history_of(scene: Scene, track: tuple[Float[np.ndarray, "N 4"], ...]) -> History:
    """Latest states of all agents as a predictor's history."""
    players = scene.game.players
    states = np.stack(track)
    planar = states.copy()
    headings = np.full(states.shape[:2], np.nan)
    for j, player in enumerate(players):
        planar[:, j, 2:] = [planar_velocity(player.dynamics, s) for s in states[:, j]]
        if isinstance(player.dynamics, Vehicle):
            headings[:, j] = states[:, j, 3]
    kinds = tuple("car" if isinstance(p.dynamics, Vehicle) else "pedestrian" for p in players)
    extents = np.full((len(players), 2), np.nan)
    return History(planar, headings, kinds, extents, scene.dt, context_of(scene))


def context_of(scene: Scene) -> Context:
    """Context of an environment for predictors: its routes and its game."""
    game = None
    if scene.population is not None:
        game = SceneGame(scene.game, scene.population, scene.noise_std)
    return Context(scene.routes, np.ones(len(scene.routes)), game)


def planned_positions(
    scene: Scene, ego: int, state: Float[np.ndarray, "4"], plan: Plan | None
) -> Float[np.ndarray, "T 2"]:
    """The ego's positions by its last plan, and beyond its end; straight motion without one."""
    horizon, dynamics = scene.game.horizon, scene.game.players[ego].dynamics
    if plan is None:
        times = scene.dt * np.arange(1, horizon + 1)[:, None]
        return np.asarray(state[:2] + times * planar_velocity(dynamics, state))
    path = np.asarray(plan.solution.states[plan.player])[2:, :2]
    rest = np.repeat(path[-1:], max(horizon - len(path), 0), axis=0)
    return np.concatenate([path, rest])[:horizon]


def feared_positions(
    forecast: Forecast, ego: int, own: Float[np.ndarray, "T 2"], deviations: float
) -> Float[np.ndarray, "T N 2"]:
    """The most likely positions, moved towards the ego's by that many standard deviations.

    To keep a distance from there is a linearised chance constraint along the line between the two
    (Zhu and Alonso-Mora, "Chance-constrained collision avoidance for MAVs in dynamic
    environments", RA-L 2019). No agent is moved farther than to the ego's position.
    """
    places = np.array(forecast.most_likely)
    if forecast.covariance is None:
        return places
    covariance = forecast.covariance[int(np.argmax(forecast.probabilities))]
    for j in range(places.shape[1]):
        if j == ego:
            continue
        away = own - places[:, j]
        distance = np.linalg.norm(away, axis=1)
        along = away / np.maximum(distance, SMALL)[:, None]
        spread = np.sqrt(np.einsum("ta,tac,tc->t", along, covariance[:, j], along))
        places[:, j] += np.minimum(deviations * spread, distance)[:, None] * along
    return places


def states_along(
    dynamics: Dynamics,
    state: Float[np.ndarray, "4"],
    places: Float[np.ndarray, "T 2"],
    dt: float,
) -> Float[np.ndarray, "T 4"]:
    """States (as `dynamics` has them) of an agent that is at `places` after 1..T steps."""
    steps = np.diff(np.vstack([state[:2], places]), axis=0)
    found, heading = [], float(state[3])
    for place, step in zip(places, steps, strict=True):
        now = moving_state(dynamics, place, step / dt, heading)
        heading = float(now[3])
        found.append(now)
    return np.stack(found)


def _gammas(forecast: Forecast, ego: int) -> dict[int, tuple[float, float]]:
    """Means and deviations of others' discount factors, where the forecast has them."""
    if forecast.gamma is None:
        return {}
    spread = forecast.gamma_deviation
    spread = np.zeros(len(forecast.gamma)) if spread is None else spread
    return {j: (float(g), float(spread[j])) for j, g in enumerate(forecast.gamma) if j != ego}
