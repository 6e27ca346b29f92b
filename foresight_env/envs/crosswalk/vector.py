"""Many crosswalks at once: `gymnasium.make_vec("foresight/Crosswalk-v0", num_envs=1024)`.

The same episodes as those of `gymnasium.vector.SyncVectorEnv` around `foresight/Crosswalk-v0` with
the same seeds, and the same arguments, but all of them move in one compiled program and all their
games are solved in one batch. An environment whose episode has ended begins a new one in the next
step, whose action it ignores (`AutoresetMode.NEXT_STEP`), or, as learners like it, in the same step
(`AutoresetMode.SAME_STEP`): its last observation is then in `infos["final_obs"]`.

Not here: rendering, custom behaviours, and the others' plans in the information. Wrong
actions raise `ValueError` before anything changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, Float32, Int

from foresight_env.annotations import no_type_check
from foresight_env.compilation import compiled
from foresight_env.envs.core import checks
from foresight_env.envs.core.world import stacked
from foresight_env.envs.crosswalk.env import CrosswalkEnv
from foresight_env.envs.crosswalk.functional import (
    EGO,
    CrosswalkSetting,
    CrosswalkState,
    Outcome,
    at_start,
    move,
    observed,
)
from foresight_env.envs.crosswalk.vector_oracle import VectorOracle, padded
from foresight_env.envs.crosswalk.world import crosswalk_world
from foresight_env.precision import in_double_precision
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT, DT, HORIZON, Ranges
from foresight_env.scenarios.episode_parameters import EpisodeParameters

Infos = dict[str, Any]


@in_double_precision
@compiled(static_argnums=0)
def _move(
    setting: CrosswalkSetting, state: CrosswalkState, wanted: Any, noise: Any
) -> tuple[CrosswalkState, Outcome, Any]:
    """All environments by one step, and their observations."""

    def one(state: CrosswalkState, wanted: Any, noise: Any) -> Any:
        state, outcome = move(setting, state, wanted)
        return state, outcome, observed(setting, state, noise)

    return jax.vmap(one)(state, wanted, noise)


@in_double_precision
@compiled(static_argnums=0)
def _start(
    setting: CrosswalkSetting, episode_parameters: EpisodeParameters, noise: Any
) -> tuple[CrosswalkState, Any]:
    """First states and their observations."""

    def one(episode_parameters: EpisodeParameters, noise: Any) -> Any:
        state = at_start(setting, episode_parameters)
        return state, observed(setting, state, noise)

    return jax.vmap(one)(episode_parameters, noise)


class CrosswalkVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Pedestrian 0 among others, many times."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        **CrosswalkEnv.metadata,
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    @no_type_check
    def __init__(
        self,
        num_envs: int = 1,
        *,
        players: int = 2,
        behaviour: str = "receding",
        observation: str = "full",
        noise_std: float = 0.05,
        proximity: str = "soft",
        ranges: Ranges = Ranges(),
        planning_horizon: int = HORIZON,
        max_steps: int = 60,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(
                f"render_mode: is {render_mode!r}; many crosswalks at once draw nothing, use "
                "gymnasium.make for one that does"
            )
        if callable(behaviour):
            raise ValueError(
                "behaviour: is a factory; expected 'receding' or 'open_loop', use "
                "gymnasium.make_vec(..., vectorization_mode='sync') for a custom one"
            )
        self.num_envs = checks.whole("num_envs", num_envs, 1)
        mode = _autoreset_mode(autoreset_mode)
        # Gymnasium's own vector environments keep theirs with the instance, too.
        self.metadata = {**self.metadata, "autoreset_mode": mode}  # type: ignore[misc]
        self._same_step = mode == AutoresetMode.SAME_STEP
        self._setting = CrosswalkSetting(
            checks.whole("players", players, 2, 6),
            checks.choice("behaviour", behaviour, ("receding", "open_loop")),
            checks.choice("observation", observation, ("full", "positions")),
            checks.not_negative("noise_std", noise_std),
            checks.check_proximity(proximity),
            checks.check_ranges(ranges, Ranges),
            checks.whole("planning_horizon", planning_horizon, 1),
            checks.whole("max_steps", max_steps, 1),
        )
        setting = self._setting
        self._world = crosswalk_world(setting.players, setting.proximity, setting.ranges)
        # The single environment's own spaces: there is one place that says what they are.
        single = CrosswalkEnv(
            players=setting.players, observation=setting.observation, planning_horizon=1
        )
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._sources: list[np.random.Generator | None] = [None] * self.num_envs
        self._oracle = VectorOracle(setting, self.num_envs)
        self._state: CrosswalkState | None = None
        self._theta: dict[str, np.ndarray] = {}
        shape = (self.num_envs, setting.max_steps + 1, setting.players * setting.shown)
        self._noise = np.zeros(shape)
        self._over = np.zeros(self.num_envs, dtype=bool)

    @no_type_check
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Float32[np.ndarray, "B size"], Infos]:
        """Begin all episodes; environment k has seed `seed + k`, or `seed[k]`."""
        seeds = self._seeds(seed)
        chosen = checks.check_options(options, self._world)
        for k, own in enumerate(seeds):
            if own is not None:
                self._sources[k] = np_random(own)[0]
        observations: Any = np.empty(self.observation_space.shape, np.float32)
        self._renew(np.arange(self.num_envs), chosen, observations)
        self._over[:] = False
        return observations, self._infos()

    def _seeds(self, seed: Any) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if np.ndim(seed) == 0:
            first = checks.check_seed(seed)
            return [first + k for k in range(self.num_envs)]  # type: ignore[operator]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: has {len(seed)} entries; expected {self.num_envs}")
        return [checks.check_seed(own) for own in seed]

    def _renew(
        self,
        places: Int[np.ndarray, "b"],
        options: dict[str, Any],
        observations: Float32[np.ndarray, "B size"],
    ) -> None:
        """New episodes in these places, drawn in the order of the single environment."""
        drawn_parameters = []
        for k in places:
            source = self._sources[k]
            if source is None:
                source = self._sources[k] = np_random()[0]
            drawn = self._world.draw(source)
            noise = np.random.default_rng(source.integers(2**63))
            drawn_parameters.append(checks.with_options(drawn, options))
            # One draw for a whole episode: the same numbers as one after the other.
            self._noise[k] = noise.normal(0.0, self._setting.noise_std, self._noise[k].shape)
        batch = _stack(drawn_parameters, padded(len(places)))
        first = self._noise[places, 0]
        first = np.concatenate(
            [first, np.zeros((padded(len(places)) - len(places), first.shape[1]))]
        )
        state, shown = _start(self._setting, batch, first)
        state, shown = jax.tree.map(lambda v: v[: len(places)], (state, shown))
        observations[places] = shown
        if self._state is None:
            self._state = jax.tree.map(np.array, state)
        else:
            jax.tree.map(lambda whole, new: _put(whole, places, new), self._state, state)
        self._theta = stacked_many(self._state.episode_parameters)
        self._oracle.forget(places)

    @no_type_check
    def step(
        self, actions: Float[np.ndarray, "B 2"]
    ) -> tuple[
        Float32[np.ndarray, "B size"],
        Float[np.ndarray, "B"],
        Bool[np.ndarray, "B"],
        Bool[np.ndarray, "B"],
        Infos,
    ]:
        """Move all episodes by one step; those that had ended are reset."""
        if self._state is None:
            raise ResetNeeded("step: there are no episodes; call reset first")
        requested = self._checked(actions)
        state, live = self._state, ~self._over
        wanted = self._oracle.act(state, live)
        brakes = ~self._oracle.known
        if brakes.any():
            stopping = -state.states[brakes][..., 2:] / DT
            wanted[brakes] = np.clip(stopping, -CONTROL_LIMIT, CONTROL_LIMIT)
        wanted[:, EGO] = requested
        steps = np.minimum(np.asarray(state.steps) + 1, self._setting.max_steps)
        noise = self._noise[np.arange(self.num_envs), steps]
        moved, outcome, shown = _move(self._setting, state, wanted, noise)
        moved = jax.tree.map(np.array, moved)
        observations = np.array(shown, dtype=np.float32)
        rewards = -np.array(outcome.cost[:, EGO])
        terminated, truncated = np.array(outcome.terminated), np.array(outcome.truncated)
        ended = np.flatnonzero(self._over)
        self._state = moved
        self._over = terminated | truncated
        if ended.size:
            rewards[ended] = 0.0
            terminated[ended] = truncated[ended] = self._over[ended] = False
            self._renew(ended, {}, observations)
        final = {}
        if self._same_step and self._over.any():
            ended = np.flatnonzero(self._over)
            final = self._final(observations)
            self._renew(ended, {}, observations)
            self._over[:] = False
        return observations, rewards, terminated, truncated, {**final, **self._infos()}

    def _final(self, observations: Float32[np.ndarray, "B size"]) -> Infos:
        """Of episodes that ended in this step, for `AutoresetMode.SAME_STEP`."""
        last = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(self._over):
            last[k] = observations[k].copy()
        final = {"final_obs": last, "final_info": self._infos(self._over)}
        return {**final, **{f"_{name}": self._over.copy() for name in final}}

    def _checked(self, actions: Any) -> Float[np.ndarray, "B 2"]:
        found = np.asarray(actions)
        space: Any = self.action_space
        if found.shape != space.shape or found.dtype.kind not in "fiu":
            raise ValueError(
                f"actions: have shape {found.shape} and type {found.dtype}; expected numbers of "
                f"shape {space.shape}"
            )
        one: Any = self.single_action_space
        inside = ((found >= space.low) & (found <= space.high)).all(axis=1)  # NaN fails
        wrong = np.flatnonzero(~inside & ~self._over)
        if wrong.size:
            raise ValueError(
                f"actions[{wrong[0]}]: is {found[wrong[0]]}, outside the action space; clip it to "
                f"{one.low} ... {one.high}"
            )
        return np.where(self._over[:, None], 0.0, found).astype(float)

    def _infos(self, there: Bool[np.ndarray, "B"] | None = None) -> Infos:
        """Of all environments, or of some, in the form of Gymnasium's vector environments."""
        state = self._state
        assert state is not None
        there = np.ones(self.num_envs, dtype=bool) if there is None else there
        collided, reached = state.collided[:, EGO], state.reached[:, EGO]
        oracle = self._oracle
        infos = {
            "state": state.states.copy(),
            "gamma": state.episode_parameters.gamma.copy(),
            "theta": _masked({name: v.copy() for name, v in self._theta.items()}, there),
            "controls": state.controls.copy(),
            "applied_action": state.controls[:, EGO].copy(),
            "min_distance": state.closest[:, EGO].copy(),
            "collision": collided.copy(),
            "off_road": np.zeros(self.num_envs, dtype=bool),
            "goal_reached": reached.copy(),
            "is_success": reached & ~collided,
            "solver_status": oracle.status.copy(),
            "solver_residual": oracle.residual.copy(),
            "solver_failures": oracle.failures.copy(),
            "time": state.steps * DT,
        }
        return _masked(infos, there)


def _masked(infos: Infos, there: Bool[np.ndarray, "B"]) -> Infos:
    """Values and a mask of the environments that have one; zero where there is none."""
    for value in infos.values():
        if isinstance(value, np.ndarray):
            value[~there] = 0
    return {**infos, **{f"_{name}": there.copy() for name in infos}}


def _autoreset_mode(given: Any) -> AutoresetMode:
    known = {m.value: m for m in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)}
    found = known.get(given.value if isinstance(given, AutoresetMode) else given)
    if found is None:
        raise ValueError(
            f"autoreset_mode: is {given!r}; expected one of {', '.join(map(repr, known))}"
        )
    return found


def _put(whole: np.ndarray, places: Int[np.ndarray, "b"], new: np.ndarray) -> None:
    whole[places] = new


def _stack(drawn_parameters: Sequence[EpisodeParameters], size: int) -> EpisodeParameters:
    """With a leading axis of that size; the last one is repeated."""
    full = [*drawn_parameters, *[drawn_parameters[-1]] * (size - len(drawn_parameters))]
    found: EpisodeParameters = jax.tree.map(
        lambda *v: np.stack([np.asarray(x, float) for x in v]), *full
    )
    return found


def stacked_many(episode_parameters: EpisodeParameters) -> dict[str, np.ndarray]:
    """`world.stacked` of many environments: parameters by name, (B, N, ...)."""
    one = stacked(episode_parameters.theta)
    return {name: np.swapaxes(values, 0, 1) for name, values in one.items()}
