"""Crosswalk: pedestrians of different foresight cross each other's way diagonally.

| Creation | `foresight_env.envs.crosswalk_v0.parallel_env()` |
|---|---|
| By PettingZoo id | `pettingzoo.make("parallel", "foresight/crosswalk-v0")` |
| Single agent | `gymnasium.make("foresight/Crosswalk-v0")` |
| Actions | continuous |
| Parallel API | yes |
| Agents | the controlled ones of `pedestrian_0` ... `pedestrian_5` |
| Action shape, values | (2,), -10 to 10 m/s^2, float32 |
| Observation shape | (4 N + 2,) or (2 N + 2,), float32 |

N pedestrians walk to goals opposite of them and keep apart on the way. Pedestrian i weighs what it
pays t steps ahead with `gamma_i ** t`: the smaller its discount factor, the later it reacts. The
user controls some of them; the others play an equilibrium of the game between all. Nobody is told
the discount factors, goals and weights of the others.

**Motion.** Double integrator, 0.1 s per step: an action is held constant over the step. No velocity
exceeds 0.8 m/s per axis: the applied control is the nearest that keeps the next velocity inside.

**Actions.** `[ax, ay]`, accelerations in m/s^2. Wrong actions raise `ValueError` before anything
changes: one missing, an unknown agent, a wrong shape, NaN, a value outside the space.

**Observations.** Of each pedestrian `[px, py, vx, vy]` (`"full"`) or `[px, py]` (`"positions"`),
in m and m/s: the agent itself first, then the others in the order of their indices, all with
independent Gaussian noise; then the agent's own goal `[gx, gy]`, exact. Positions and goals lie in
+-20 m, velocities in +-5 m/s; what would lie outside is clipped.

**Rewards.** Minus the agent's own stage cost, nothing discounted:

    r_i = -(goal_weight |p_i' - goal_i|^2 + control_weight |u_i|^2
            + collision_weight sum_j max(0, 1.2 - |p_i' - p_j'|^2))

with applied controls `u`, reached positions `p'` and the agent's own weights. An agent that
maximises the return discounted by `gamma_i` plays the game of the others. The last term is that of
`proximity="soft"`. `"reference"` has `collision_weight sum_j max(0, 1.2 - |p_i' - p_j'|)^2` in its
place, which the oracle does not discount; `"hard"`, where the oracle keeps apart by constraint, has
nothing there.

**End of an episode**, common to all agents. Terminated: a controlled agent collided (two centres
closer than 0.5 m at any moment of a step, computed exactly), or every controlled agent has been
within 0.25 m of its goal at the end of a step. Truncated: `max_steps` without either. Afterwards
`agents` is empty and `step` raises `gymnasium.error.ResetNeeded`.

**Arguments.**

- `players=2`: number of pedestrians, 2 to 6.
- `controlled=(0,)`: indices of those that the user controls; `None` or `"all"` for everybody.
- `behaviour="receding"`: what the others do. `"receding"` solves the game of all players, true
  parameters and true states, at every step; `"open_loop"` solves it once, over `max_steps` stages,
  and follows that plan. When a solve fails, also from a cold start, the previous plan is followed;
  without one, the others brake to rest. Or a factory of a behaviour of one's own (module `oracle`).
- `observation="full"`: or `"positions"`.
- `noise_std=0.05`: standard deviation of the noise of every observed coordinate, m and m/s.
- `proximity="soft"`: how pedestrians keep apart (`scenarios.crosswalk.crosswalk_game`).
- `ranges=Ranges()`: from where an episode's hidden parameters are drawn, uniformly.
- `planning_horizon=25`: stages of the game that `"receding"` solves and that `scene` holds.
- `max_steps=60`: steps until truncation.
- `render_mode=None`: `"rgb_array"` or `"human"`.

**Options of `reset`**, each in place of what would be drawn: `"gamma"` (N,), `"goals"` (N, 2) m,
`"initial_states"` (N, 4) m and m/s, `"crossing"`, a whole `scenarios.crosswalk.Crossing`. Single
entries win over `"crossing"`. Without a seed, `reset` continues the stream of the last one; an
episode does not depend on how long the ones before it took.

**Information** of each agent, and the only place of ground truth: `state` (N, 4), `gamma` (N,),
`theta` (`goal` (N, 2) and weights (N,)), `controls` (N, 2) applied by everybody in the last step,
`applied_action` (2,) of this agent, `min_distance` (m; its smallest centre distance so far minus
0.5 m), `collision` (of this agent), `goal_reached`, `is_success` (goal reached, no collision),
`solver_status` (`equilibrium.Status`; -1 while nothing was solved), `solver_residual`,
`solver_failures` (steps of this episode), `time` (s).

**Version history.** v0: first version.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from jaxtyping import Float, Float32
from pettingzoo import ParallelEnv

from foresight_env.envs import checks
from foresight_env.envs.checks import no_type_check
from foresight_env.envs.episode import GOAL_RADIUS, Episode
from foresight_env.envs.motion import advance, applicable, closest_approach, observe
from foresight_env.envs.oracle import BehaviourFactory, BehaviourSetting, SolverReport
from foresight_env.envs.overlay import Overlay
from foresight_env.envs.scene import Observation, Own, Scene, agent_name
from foresight_env.scenarios.crosswalk import (
    COLLISION_DISTANCE,
    CONTROL_LIMIT,
    DT,
    HORIZON,
    Proximity,
    Ranges,
    crosswalk_game,
    draw_crossing,
)

VELOCITY_LIMIT = 5.0
"""Largest velocity that an observation can show, m/s: noise goes beyond the speed limit."""

Info = dict[str, Any]
Results = tuple[
    dict[str, Float32[np.ndarray, "size"]],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, Info],
]


class CrosswalkParallelEnv(ParallelEnv[str, np.ndarray, np.ndarray]):  # type: ignore[misc]
    """The crosswalk; the module's docstring is its page."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": "crosswalk_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": round(1.0 / DT),
        "is_parallelizable": True,
    }

    @no_type_check
    def __init__(
        self,
        players: int = 2,
        controlled: tuple[int, ...] | Literal["all"] | None = (0,),
        behaviour: Literal["receding", "open_loop"] | BehaviourFactory = "receding",
        observation: Observation = "full",
        noise_std: float = 0.05,
        proximity: Proximity = "soft",
        ranges: Ranges = Ranges(),
        planning_horizon: int = HORIZON,
        max_steps: int = 60,
        render_mode: Literal["human", "rgb_array"] | None = None,
    ) -> None:
        count = checks.whole("players", players, 2, 6)
        variant = checks.check_proximity(proximity)
        horizon = checks.whole("planning_horizon", planning_horizon, 1)
        limit = checks.whole("max_steps", max_steps, 1)
        modes = (None, *self.metadata["render_modes"])
        self.render_mode = checks.choice("render_mode", render_mode, modes)
        self._ranges = checks.check_ranges(ranges)
        self._scene = Scene(
            crosswalk_game(count, horizon, variant),
            checks.choice("observation", observation, ("full", "positions")),
            checks.not_negative("noise_std", noise_std),
            checks.check_controlled(controlled, count),
            limit,
            GOAL_RADIUS,
        )
        indices = self._scene.controlled
        factory = checks.check_behaviour(behaviour)
        setting = BehaviourSetting(count, horizon, limit, variant)
        self._behaviour = None if len(indices) == count else factory(setting)
        self._models = tuple(self._scene.observation_model(i) for i in indices)
        self.possible_agents = [agent_name(i) for i in indices]
        self.agents: list[str] = []
        high = [checks.POSITION_LIMIT] * 2
        high += [VELOCITY_LIMIT] * 2 if observation == "full" else []
        bound = np.array(high * count + [checks.POSITION_LIMIT] * 2, dtype=np.float32)
        control = np.full(2, CONTROL_LIMIT, dtype=np.float32)
        self._observation_spaces = {a: Box(-bound, bound) for a in self.possible_agents}
        self._action_spaces = {a: Box(-control, control) for a in self.possible_agents}
        self._random: np.random.Generator | None = None
        self._episode: Episode | None = None
        self._overlay = Overlay()
        self._renderer: Any = None

    @property
    def scene(self) -> Scene:
        """What an agent's policy may know."""
        return self._scene

    @property
    def np_random(self) -> np.random.Generator:
        """The generator that episodes are drawn from; seeded from entropy before any `reset`."""
        if self._random is None:
            self._random = np_random()[0]
        return self._random

    def observation_space(self, agent: str) -> Box:
        """The agent's observation space, always the same object."""
        return self._space(self._observation_spaces, agent)

    def action_space(self, agent: str) -> Box:
        """The agent's action space, always the same object."""
        return self._space(self._action_spaces, agent)

    def _space(self, spaces: Mapping[str, Box], agent: str) -> Box:
        if agent not in spaces:
            raise ValueError(f"agent: {agent!r} is not one of {self.possible_agents}")
        return spaces[agent]

    @no_type_check
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Float32[np.ndarray, "size"]], dict[str, Info]]:
        """Begin an episode; see the module's docstring for `options`."""
        seed = checks.check_seed(seed)
        chosen = checks.check_options(options, self._scene.players)
        source = self.np_random if seed is None else np_random(seed)[0]
        # Always drawn, and in this order, so that options and the length of episodes do not change
        # what later episodes are like.
        drawn = draw_crossing(source, self._scene.players, self._ranges)
        noise = np.random.default_rng(source.integers(2**63))
        crossing = checks.with_options(drawn, chosen)
        self._random = source
        self._episode = Episode.begin(crossing, noise)
        indices = self._scene.controlled
        own = {i: Own(crossing.theta[i], float(crossing.gamma[i])) for i in indices}
        self._scene = replace(self._scene, _own=own)
        if self._behaviour is not None:
            self._behaviour.reset(deepcopy(crossing))
        self.agents = self.possible_agents[:]
        self._overlay = Overlay()
        self._show()
        return self._observations(self._episode), self._infos(self._episode)

    @no_type_check
    def step(self, actions: dict[str, np.ndarray]) -> Results:
        """Move everybody by one step."""
        episode = self._episode
        if episode is None or not self.agents:
            raise ResetNeeded("step: there is no episode, or it has ended; call reset first")
        requested = checks.check_actions(actions, self.agents)
        scene = self._scene
        wanted = self._uncontrolled(episode)
        for i, agent in zip(scene.controlled, self.agents, strict=True):
            wanted[i] = requested[agent]
        before = episode.states
        controls = applicable(before, wanted, scene.dt)
        after, costs = advance(scene.game, before, controls, episode.crossing.theta)
        distances = closest_approach(before, controls, scene.dt).min(axis=1)
        episode.advance(controls, distances, after)
        indices = list(scene.controlled)
        ended = bool(episode.collided[indices].any() or episode.reached[indices].all())
        timed_out = not ended and episode.steps >= scene.max_steps
        live = self.agents
        result = (
            self._observations(episode),
            {agent: -float(costs[i]) for i, agent in zip(indices, live, strict=True)},
            dict.fromkeys(live, ended),
            dict.fromkeys(live, timed_out),
            self._infos(episode),
        )
        if ended or timed_out:
            self.agents = []
        self._show()
        return result

    def _uncontrolled(self, episode: Episode) -> Float[np.ndarray, "N 2"]:
        """Controls of everybody by the behaviour; zeros when there is none."""
        if self._behaviour is None:
            return np.zeros_like(episode.controls)
        controls = np.array(self._behaviour.act(episode.states.copy()), dtype=float)
        if controls.shape != episode.controls.shape or not np.isfinite(controls).all():
            raise ValueError(
                f"behaviour: act returned {controls!r}; expected finite controls of shape "
                f"{episode.controls.shape}"
            )
        return controls

    def _observations(self, episode: Episode) -> dict[str, Float32[np.ndarray, "size"]]:
        observations = {}
        seen = observe(self._models, episode.states)
        for i, agent, exact in zip(self._scene.controlled, self.possible_agents, seen, strict=True):
            noisy = exact + episode.noise.normal(0.0, self._scene.noise_std, exact.shape)
            whole = np.concatenate([noisy, episode.crossing.theta[i]["goal"]]).astype(np.float32)
            space = self._observation_spaces[agent]
            observations[agent] = np.clip(whole, space.low, space.high)
        return observations

    def _infos(self, episode: Episode) -> dict[str, Info]:
        report = SolverReport() if self._behaviour is None else self._behaviour.report
        theta = episode.crossing.theta
        return {
            agent: {
                "state": episode.states.copy(),
                "gamma": episode.crossing.gamma.copy(),
                "theta": {name: np.stack([own[name] for own in theta]) for name in theta[0]},
                "controls": episode.controls.copy(),
                "applied_action": episode.controls[i].copy(),
                "min_distance": float(episode.closest[i]) - COLLISION_DISTANCE,
                "collision": bool(episode.collided[i]),
                "goal_reached": bool(episode.reached[i]),
                "is_success": bool(episode.reached[i] and not episode.collided[i]),
                "solver_status": int(report.status),
                "solver_residual": float(report.residual),
                "solver_failures": int(report.failures),
                "time": episode.steps * self._scene.dt,
            }
            for i, agent in zip(self._scene.controlled, self.possible_agents, strict=True)
        }

    @no_type_check
    def set_overlay(self, overlay: Overlay) -> None:
        """Draw this over the scene from now on, until the next call or `reset`."""
        if not isinstance(overlay, Overlay):
            raise ValueError(
                f"overlay: is {overlay!r}; expected foresight_env.envs.overlay.Overlay"
            )
        self._overlay = overlay.checked(self._scene.players)

    def render(self) -> np.ndarray | None:
        """The current frame, (H, W, 3) uint8; None with `"human"`, which draws in a window."""
        if self.render_mode is None:
            logger.warn("render: make the environment with render_mode='rgb_array' or 'human'")
            return None
        if self._episode is None:
            raise ResetNeeded("render: there is no episode; call reset first")
        from foresight_env.envs.render import Frame, Renderer

        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        episode = self._episode
        planned = None if self._behaviour is None else self._behaviour.planned
        frame = Frame(
            trail=np.stack(episode.trail),
            goals=np.stack([own["goal"] for own in episode.crossing.theta]),
            gamma=np.asarray(episode.crossing.gamma),
            controlled=self._scene.controlled,
            collided=episode.collided,
            planned=planned or (),
            overlay=self._overlay,
            time=episode.steps * self._scene.dt,
        )
        image: np.ndarray | None = self._renderer.draw(frame)
        return image

    def _show(self) -> None:
        """Keep the window up to date, as Gymnasium wants it of `"human"`."""
        if self.render_mode == "human":
            self.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


parallel_env = CrosswalkParallelEnv
"""The name that PettingZoo gives to parallel environments."""
