"""The crosswalk as pure functions of JAX arrays, for `jit`, `vmap` and `scan`.

    setting = CrosswalkSetting(behaviour="open_loop")
    state = begin(setting, draw(setting, key))
    state, step = advance(setting, state, action)
    observation = observe(setting, state, noise_key)

The same world as `foresight_env.envs.crosswalk.env`, which documents spaces, rewards and ends.
The ego is player 0. Arrays have the caller's precision; the solver works in double precision.
Nothing is checked and nothing restarts by itself: `CrosswalkVectorEnv` does both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from foresight_env.envs.core.behaviours import NOTHING_SOLVED
from foresight_env.envs.core.motion import FIRST_STAGE
from foresight_env.envs.crosswalk.world import GOAL_RADIUS, POSITION_LIMIT, VELOCITY_LIMIT
from foresight_env.equilibrium import Solution, Status, shift, solve
from foresight_env.games import Game, stage_cost
from foresight_env.games.types import AnyArray
from foresight_env.names import BehaviourName, Observation
from foresight_env.scenarios.crosswalk import (
    COLLISION_DISTANCE,
    CONTROL_LIMIT,
    DT,
    HORIZON,
    SPEED_LIMIT,
    Proximity,
    Ranges,
    crosswalk_game,
    nominal_setting,
    player_theta,
)
from foresight_env.scenarios.episode_parameters import EpisodeParameters

EGO = 0
"""The player whose actions the caller chooses."""


@dataclass(frozen=True)
class CrosswalkSetting:
    """Arguments of the environment, as on its page."""

    players: int = 2
    behaviour: BehaviourName = "receding"
    observation: Observation = "full"
    noise_std: float = 0.05
    proximity: Proximity = "soft"
    ranges: Ranges = Ranges()
    planning_horizon: int = HORIZON
    max_steps: int = 60

    @property
    def game(self) -> Game:
        """Game that the others solve."""
        receding = self.behaviour == "receding"
        horizon = self.planning_horizon if receding else self.max_steps
        return crosswalk_game(self.players, horizon, self.proximity)

    @property
    def shown(self) -> int:
        """Entries of a state that are observed."""
        return 4 if self.observation == "full" else 2


class CrosswalkState(NamedTuple):
    """All that changes in an episode, and its hidden truth; a PyTree of arrays."""

    episode_parameters: EpisodeParameters
    states: Float[AnyArray, "N 4"]
    controls: Float[AnyArray, "N 2"]
    """As applied in the last step, m/s^2."""
    closest: Float[AnyArray, "N"]
    """Smallest distance of discs so far, m; negative: they overlapped."""
    collided: Bool[AnyArray, "N"]
    reached: Bool[AnyArray, "N"]
    steps: Int[AnyArray, ""]


class Planned(NamedTuple):
    """A state and what the others mean to do."""

    state: CrosswalkState
    plan: Solution
    """Of the latest solve, shifted to now; only read where `known`."""
    known: Bool[AnyArray, ""]
    status: Int[AnyArray, ""]
    """`equilibrium.Status` of the latest solve, -1 before the first."""
    failures: Int[AnyArray, ""]


class Outcome(NamedTuple):
    """Result of a step."""

    cost: Float[AnyArray, "N"]
    """Of all players, undiscounted; the ego's reward is minus its own."""
    terminated: Bool[AnyArray, ""]
    truncated: Bool[AnyArray, ""]


def draw(setting: CrosswalkSetting, key: PRNGKeyArray) -> EpisodeParameters:
    """An episode's hidden truth, from the distribution of `scenarios.crosswalk.draw_crossing`."""
    nominal, ranges = nominal_setting(setting.players), setting.ranges
    count, keys = setting.players, jax.random.split(key, 5)

    def uniform(key: PRNGKeyArray, limits: tuple[float, float], shape: tuple[int, ...]) -> Any:
        return jax.random.uniform(key, shape, minval=limits[0], maxval=limits[1])

    shifts = uniform(keys[0], (-ranges.start, ranges.start), (count, 2))
    goals = nominal.goals + uniform(keys[1], (-ranges.goal, ranges.goal), (count, 2))
    gamma = uniform(keys[2], ranges.gamma, (count,))
    control = uniform(keys[3], ranges.control_weight, (count,))
    collision = uniform(keys[4], ranges.collision_weight, (count,))
    states: Any = jnp.asarray(nominal.initial_state).at[:, :2].add(shifts)
    theta = tuple(
        {
            **player_theta(goals[i]),
            "control_weight": control[i],
            "collision_weight": collision[i],
        }
        for i in range(count)
    )
    return EpisodeParameters(states, jax.tree.map(jnp.asarray, theta), gamma)


def at_start(setting: CrosswalkSetting, episode_parameters: EpisodeParameters) -> CrosswalkState:
    """The first instant of an episode."""
    states = jnp.asarray(episode_parameters.initial_state)
    controls = jnp.zeros((setting.players, 2), states.dtype)
    none = jnp.zeros(setting.players, bool)
    gaps = closest_approach(states, controls, states).min(axis=1) - COLLISION_DISTANCE
    steps = jnp.zeros((), int)
    state = CrosswalkState(episode_parameters, states, controls, gaps, none, none, steps)
    return _arrived(state, states)


def begin(setting: CrosswalkSetting, episode_parameters: EpisodeParameters) -> Planned:
    """The first instant, and with `"open_loop"` the plan for the whole episode."""
    state = at_start(setting, episode_parameters)
    solution = _solved(setting, state, None)
    fine = solution.status == Status.SOLVED
    if setting.behaviour == "open_loop":
        return Planned(state, solution, fine, solution.status, jnp.asarray(~fine, int))
    nothing = jnp.asarray(NOTHING_SOLVED), jnp.zeros((), int)
    # What is solved here is solved again in the first step, from there: two Newton steps.
    return Planned(state, solution, fine, *nothing)


def advance(
    setting: CrosswalkSetting, planned: Planned, action: Float[AnyArray, "2"]
) -> tuple[Planned, Outcome]:
    """One step: the ego's action (m/s^2), and all others' part of the plan."""
    if setting.behaviour == "receding":
        solution = _solved(setting, planned.state, planned.plan)
        fine = solution.status == Status.SOLVED
        plan = jax.tree.map(lambda new, old: jnp.where(fine, new, old), solution, planned.plan)
        known = fine | planned.known
        report = solution.status, planned.failures + ~fine
    else:
        plan, known = planned.plan, planned.known
        report = planned.status, planned.failures
    first = jnp.stack([u[0] for u in plan.controls])
    others = jnp.where(known, first, braking(planned.state.states))
    state, outcome = move(setting, planned.state, others.at[EGO].set(action))
    return Planned(state, shift(plan), known, *report), outcome


def _solved(
    setting: CrosswalkSetting, state: CrosswalkState, initial_guess: Solution | None
) -> Solution:
    _, theta, gamma = state.episode_parameters
    return solve(setting.game, tuple(state.states), theta, gamma, initial_guess=initial_guess)


def braking(states: Float[AnyArray, "N 4"]) -> Float[Array, "N 2"]:
    """Controls (m/s^2) that bring all players to rest as fast as the limits allow."""
    return jnp.clip(-states[:, 2:] / DT, -CONTROL_LIMIT, CONTROL_LIMIT)


def move(
    setting: CrosswalkSetting, state: CrosswalkState, requested: Float[AnyArray, "N 2"]
) -> tuple[CrosswalkState, Outcome]:
    """All players' controls (m/s^2), reduced to the limits, for one step."""
    game, before = setting.game, state.states
    bounded = jnp.clip(requested, -CONTROL_LIMIT, CONTROL_LIMIT)
    reach = (-SPEED_LIMIT - before[:, 2:]) / DT, (SPEED_LIMIT - before[:, 2:]) / DT
    controls = jnp.clip(bounded, *reach)
    u = tuple(controls)
    after = tuple(
        player.dynamics(FIRST_STAGE, own, control)
        for player, own, control in zip(game.players, before, u, strict=True)
    )
    cost = jnp.stack(
        [
            sum(stage_cost(game, i, FIRST_STAGE, after, u, own))
            for i, own in enumerate(state.episode_parameters.theta)
        ]
    )
    states = jnp.stack(after)
    # Rounding alone may leave a velocity beyond the limit that the solver insists on.
    states = states.at[:, 2:].set(jnp.clip(states[:, 2:], -SPEED_LIMIT, SPEED_LIMIT))
    gaps = closest_approach(before, controls, states).min(axis=1) - COLLISION_DISTANCE
    closest = jnp.minimum(state.closest, gaps)
    state = _arrived(
        state._replace(
            controls=controls, closest=closest, collided=closest < 0.0, steps=state.steps + 1
        ),
        states,
    )
    terminated = state.collided[EGO] | state.reached[EGO]
    return state, Outcome(cost, terminated, ~terminated & (state.steps >= setting.max_steps))


def _arrived(state: CrosswalkState, states: Float[Array, "N 4"]) -> CrosswalkState:
    goals = jnp.stack([jnp.asarray(own["goal"]) for own in state.episode_parameters.theta])
    distances = jnp.linalg.norm(states[:, :2] - goals, axis=1)
    return state._replace(states=states, reached=state.reached | (distances <= GOAL_RADIUS))


def observe(
    setting: CrosswalkSetting, state: CrosswalkState, key: PRNGKeyArray
) -> Float[Array, "size"]:
    """The ego's observation, with independent noise."""
    shape = (setting.players * setting.shown,)
    return observed(setting, state, setting.noise_std * jax.random.normal(key, shape))


def observed(
    setting: CrosswalkSetting, state: CrosswalkState, noise: Float[AnyArray, "sensed"]
) -> Float[Array, "size"]:
    """The ego's observation with this noise (m, m/s): all players, then its own goal."""
    limits = np.array([POSITION_LIMIT] * 2 + [VELOCITY_LIMIT] * 2)[: setting.shown]
    limit = np.concatenate([np.tile(limits, setting.players), limits[:2]])
    exact = state.states[:, : setting.shown].ravel() + noise
    goal = jnp.asarray(state.episode_parameters.theta[EGO]["goal"])
    return jnp.clip(jnp.concatenate([exact, goal]), -limit, limit)


SAMPLES = 9
"""Points of a step near which the smallest distance is looked for."""
POLISHINGS = 8
"""Newton steps from there: they double the digits."""


def closest_approach(
    before: Float[AnyArray, "N 4"], controls: Float[AnyArray, "N 2"], after: Float[AnyArray, "N 4"]
) -> Float[Array, "N N"]:
    """`crosswalk_world.closest_approach` in closed steps, for compiled programs.

    The squared distance is a polynomial of fourth degree in time: sampled, and from the best sample
    and both ends Newton's method goes to its minimum.
    """
    bends = 0.5 * DT**2 * controls
    slopes = after[:, :2] - before[:, :2] - bends
    curve = [v[:, None] - v[None] for v in (before[:, :2], slopes, bends)]
    start, slope, bend = curve

    def squared(s: Any) -> Array:
        s = s[..., None]
        return jnp.sum((start + s * (slope + s * bend)) ** 2, axis=-1)

    def polished(s: Array) -> Array:
        for _ in range(POLISHINGS):
            t = s[..., None]
            place, rate = start + t * (slope + t * bend), slope + 2.0 * t * bend
            first = jnp.sum(place * rate, axis=-1)
            second = jnp.sum(rate**2 + 2.0 * place * bend, axis=-1)
            step = jnp.where(second > 0.0, first / jnp.where(second > 0.0, second, 1.0), 0.0)
            s = jnp.clip(s - step, 0.0, 1.0)
        return s

    count = before.shape[0]
    grid = jnp.broadcast_to(
        jnp.linspace(0.0, 1.0, SAMPLES, dtype=start.dtype)[:, None, None], (SAMPLES, count, count)
    )
    samples = jax.vmap(squared)(grid)
    best = jnp.take_along_axis(grid, jnp.argmin(samples, axis=0)[None], axis=0)
    candidates = jnp.concatenate([best, grid[:1], grid[-1:]])
    found = jnp.minimum(
        samples.min(axis=0), jax.vmap(squared)(jax.vmap(polished)(candidates)).min(0)
    )
    # The smallest number keeps the derivative of the root finite where agents meet exactly.
    distance = jnp.sqrt(jnp.maximum(found, jnp.finfo(found.dtype).tiny))
    return jnp.where(jnp.eye(count, dtype=bool), jnp.inf, distance)
