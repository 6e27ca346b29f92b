"""Base of all parallel environments: episodes, spaces, observations, information."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from jaxtyping import Float, Float32
from pettingzoo import ParallelEnv

from foresight_env.annotations import no_type_check
from foresight_env.envs.core import checks
from foresight_env.envs.core.behaviours import BehaviourSetting, JointPlan, SolverReport
from foresight_env.envs.core.episode import EpisodeState
from foresight_env.envs.core.motion import advance, applicable, observe
from foresight_env.envs.core.scene import Own, Scene, observation_order
from foresight_env.envs.core.world import World, stacked
from foresight_env.envs.rendering.overlay import Overlay

Info = dict[str, Any]
StepResults = tuple[
    dict[str, Float32[np.ndarray, "size"]],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, Info],
]


class WorldParallelEnv(ParallelEnv[str, np.ndarray, np.ndarray]):  # type: ignore[misc]
    """Agents in a world; a scenario's subclass chooses the world and has the page."""

    metadata: ClassVar[dict[str, Any]] = {}

    @no_type_check
    def __init__(
        self,
        world: World,
        *,
        controlled: Any,
        behaviour: Any,
        observation: Any,
        noise_std: Any,
        planning_horizon: Any,
        max_steps: Any,
        render_mode: Any,
    ) -> None:
        self._world = world
        count = world.players
        horizon = checks.whole("planning_horizon", planning_horizon, 1)
        limit = checks.whole("max_steps", max_steps, 1)
        modes = (None, *self.metadata["render_modes"])
        self.render_mode = checks.choice("render_mode", render_mode, modes)
        game = world.game(horizon)
        self._scene = Scene(
            game,
            checks.choice("observation", observation, ("full", "positions")),
            checks.not_negative("noise_std", noise_std),
            checks.check_controlled(controlled, count),
            limit,
            world.names,
            tuple(float(radius) for radius in world.goal_radius),
            world.footprints,
            world.opponent_prior,
            world.population,
            world.routes,
        )
        indices = self._scene.controlled
        factory = checks.check_behaviour(behaviour)
        setting = BehaviourSetting(world.game, horizon, limit)
        self._behaviour = None if len(indices) == count else factory(setting)
        self._models = tuple(self._scene.observation_model(i) for i in indices)
        self.possible_agents = [world.names[i] for i in indices]
        self.agents: list[str] = []
        self._observation_spaces = {
            agent: Box(*self._shown(i))
            for i, agent in zip(indices, self.possible_agents, strict=True)
        }
        self._action_spaces = {
            agent: Box(*checks.control_limits(game, i))
            for i, agent in zip(indices, self.possible_agents, strict=True)
        }
        self._random: np.random.Generator | None = None
        self._episode: EpisodeState | None = None
        self._overlay = Overlay()
        self._renderer: Any = None

    def _shown(
        self, player: int
    ) -> tuple[Float32[np.ndarray, "size"], Float32[np.ndarray, "size"]]:
        """Limits of a player's observation: itself, the others, its goal."""
        world, size = self._world, 4 if self._scene.observation == "full" else 2
        order = list(observation_order(player, world.players))
        low, high = (
            np.concatenate([shown[order, :size].ravel(), shown[player, :2]]).astype(np.float32)
            for shown in (world.shown_low, world.shown_high)
        )
        return low, high

    @property
    def scene(self) -> Scene:
        """Scene of the episode, for agents' policies."""
        return self._scene

    @property
    def world(self) -> World:
        """The scenario: who takes part, footprints, scenery. Nothing of the present episode."""
        return self._world

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
        chosen = checks.check_options(options, self._world)
        source = self.np_random if seed is None else np_random(seed)[0]
        # Always drawn, and in this order, so that options and the length of episodes do not change
        # what later episodes are like.
        drawn = self._world.draw(source)
        noise = np.random.default_rng(source.integers(2**63))
        episode_parameters = checks.with_options(drawn, chosen)
        self._random = source
        self._episode = EpisodeState.begin(self._world, episode_parameters, noise)
        indices = self._scene.controlled
        own = {
            i: Own(episode_parameters.theta[i], float(episode_parameters.gamma[i])) for i in indices
        }
        self._scene = replace(self._scene, _own=own)
        if self._behaviour is not None:
            self._behaviour.reset(deepcopy(episode_parameters))
        self.agents = self.possible_agents[:]
        self._overlay = Overlay()
        self._show()
        return self._observations(self._episode), self._infos(self._episode)

    @no_type_check
    def step(self, actions: dict[str, np.ndarray]) -> StepResults:
        """Move all agents by one step."""
        episode = self._episode
        if episode is None or not self.agents:
            raise ResetNeeded("step: there is no episode, or it has ended; call reset first")
        requested = checks.check_actions(actions, self._action_spaces, self.agents)
        scene = self._scene
        wanted = self._uncontrolled(episode)
        for i, agent in zip(scene.controlled, self.agents, strict=True):
            wanted[i] = requested[agent]
        before = episode.states
        controls = applicable(scene.game, before, wanted)
        after, costs = advance(scene.game, before, controls, episode.episode_parameters.theta)
        episode.advance(controls, after)
        indices = list(scene.controlled)
        lost = episode.collided[indices].any() or episode.off_road[indices].any()
        ended = bool(lost or episode.reached[indices].all())
        timed_out = not ended and episode.steps >= scene.max_steps
        live = self.agents
        if ended or timed_out:
            self.agents = []
        self._show()
        return (
            self._observations(episode),
            {agent: -float(costs[i]) for i, agent in zip(indices, live, strict=True)},
            dict.fromkeys(live, ended),
            dict.fromkeys(live, timed_out),
            self._infos(episode),
        )

    def _uncontrolled(self, episode: EpisodeState) -> Float[np.ndarray, "N m"]:
        """Controls of all agents by the behaviour; zeros when there is none."""
        if self._behaviour is None:
            return np.zeros_like(episode.controls)
        controls = np.array(self._behaviour.act(episode.states.copy()), dtype=float)
        if controls.shape != episode.controls.shape or not np.isfinite(controls).all():
            raise ValueError(
                f"behaviour: act returned {controls!r}; expected finite controls of shape "
                f"{episode.controls.shape}"
            )
        return controls

    def _observations(self, episode: EpisodeState) -> dict[str, Float32[np.ndarray, "size"]]:
        observations = {}
        seen = observe(self._models, episode.states)
        for i, agent, exact in zip(self._scene.controlled, self.possible_agents, seen, strict=True):
            noisy = exact + episode.noise.normal(0.0, self._scene.noise_std, exact.shape)
            whole = np.concatenate([noisy, episode.episode_parameters.theta[i]["goal"]]).astype(
                np.float32
            )
            space = self._observation_spaces[agent]
            observations[agent] = np.clip(whole, space.low, space.high)
        return observations

    def _plan_of_others(self, episode: EpisodeState) -> tuple[JointPlan, int]:
        """Plan that the others follow in the next step, and how many stages it has.

        As long as the planning horizon, so that environments can stand side by side: zero beyond
        the plan's stages, of which there are none without a plan or a next step.
        """
        horizon, stages = self._scene.game.horizon, 0
        shown = JointPlan(
            np.zeros((len(episode.states), horizon + 1, episode.states.shape[1])),
            np.zeros((len(episode.controls), horizon, episode.controls.shape[1])),
            solved=False,
        )
        if self._behaviour is not None and self.agents:
            plan = self._behaviour.plan(episode.states.copy())
            if plan is not None:
                stages = min(horizon, plan.controls.shape[1])
                shown.states[:, : stages + 1] = plan.states[:, : stages + 1]
                shown.controls[:, :stages] = plan.controls[:, :stages]
                shown = shown._replace(solved=plan.solved)
        return shown, stages

    def _infos(self, episode: EpisodeState) -> dict[str, Info]:
        report = SolverReport() if self._behaviour is None else self._behaviour.report
        plan, stages = self._plan_of_others(episode)
        theta = stacked(episode.episode_parameters.theta)
        return {
            agent: {
                "state": episode.states.copy(),
                "gamma": episode.episode_parameters.gamma.copy(),
                "theta": {name: values.copy() for name, values in theta.items()},
                "controls": episode.controls.copy(),
                "applied_action": episode.controls[i].copy(),
                "min_distance": float(episode.closest[i]),
                "collision": bool(episode.collided[i]),
                "off_road": bool(episode.off_road[i]),
                "goal_reached": bool(episode.reached[i]),
                "is_success": bool(
                    episode.reached[i] and not (episode.collided[i] or episode.off_road[i])
                ),
                "plan_states": plan.states.copy(),
                "plan_controls": plan.controls.copy(),
                "plan_stages": stages,
                "plan_solved": bool(plan.solved),
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
                f"overlay: is {overlay!r}; expected foresight_env.envs.rendering.overlay.Overlay"
            )
        self._overlay = overlay.checked(self._scene.players)

    def render(self) -> np.ndarray | None:
        """The current frame, (H, W, 3) uint8; None with `"human"`, which draws in a window."""
        if self.render_mode is None:
            logger.warn("render: make the environment with render_mode='rgb_array' or 'human'")
            return None
        if self._episode is None:
            raise ResetNeeded("render: there is no episode; call reset first")
        from foresight_env.envs.rendering.render import Frame, Renderer

        if self._renderer is None:
            scenery, rate = self._world.scenery, self.metadata["render_fps"]
            self._renderer = Renderer(self.render_mode, rate, scenery)
        episode = self._episode
        planned = None if self._behaviour is None else self._behaviour.planned
        frame = Frame(
            names=self._world.names,
            footprints=self._world.footprints,
            trail=np.stack(episode.trail),
            headings=np.where(self._world.turns, episode.states[:, 3], 0.0),
            goals=np.stack([own["goal"] for own in episode.episode_parameters.theta]),
            gamma=np.asarray(episode.episode_parameters.gamma),
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
