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

N pedestrians walk to goals opposite of them and keep a distance. Pedestrian i weighs what it
pays t steps ahead with `gamma_i ** t`: the smaller its discount factor, the later it reacts. The
user controls some of them; the others play an equilibrium of the game between all. The
discount factors, goals and weights of the others are hidden.

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
place, which the oracle does not discount; with `"hard"` it is
missing, since the oracle has a constraint on the distance.

**End of an episode**, common to all agents. Terminated: a controlled agent collided (two centres
closer than 0.5 m at any moment of a step, computed exactly), or every controlled agent has been
within 0.25 m of its goal at the end of a step. Truncated: `max_steps` without either. Afterwards
`agents` is empty and `step` raises `gymnasium.error.ResetNeeded`.

**Arguments.**

- `players=2`: number of pedestrians, 2 to 6.
- `controlled=(0,)`: indices of those that the user controls; `None` or `"all"` for all of them.
- `behaviour="receding"`: what the others do. `"receding"` solves the game of all players, true
  parameters and true states, at every step; `"open_loop"` solves it once, over `max_steps` stages,
  and follows that plan. When a solve fails, the previous plan is followed;
  without one, the others brake to rest. Or a factory of a custom behaviour (module
  `core.behaviours`).
- `observation="full"`: or `"positions"`.
- `noise_std=0.05`: standard deviation of the noise of every observed coordinate, m and m/s.
- `proximity="soft"`: how pedestrians keep their distance (`scenarios.crosswalk.crosswalk_game`).
- `ranges=Ranges()`: from where an episode's hidden parameters are drawn, uniformly.
- `planning_horizon=25`: stages of the game that `"receding"` solves and that `scene` holds.
- `max_steps=60`: steps until truncation.
- `render_mode=None`: `"rgb_array"` or `"human"`.

**Options of `reset`**, each in place of what would be drawn: `"gamma"` (N,), at least 0, `"goals"`
(N, 2) m, `"initial_state"` (N, 4) m and m/s, `"episode_parameters"`, a whole
`scenarios.episode_parameters.EpisodeParameters`. Single entries win over `"episode_parameters"`.
Without a seed, `reset` continues the stream of the last one; an episode does not depend on how long
the ones before it took.

**Information** of each agent, and the only place of ground truth: `state` (N, 4), `gamma` (N,),
`theta` (`goal` (N, 2) and weights (N,)), `controls` (N, 2) applied by all agents in the last step,
`applied_action` (2,) of this agent, `min_distance` (m; its smallest centre distance so far minus
0.5 m), `collision` (of this agent), `off_road` (never, here), `goal_reached`, `is_success` (goal
reached, no collision), `solver_status` (`equilibrium.Status`; -1 while nothing was solved),
`solver_residual`, `solver_failures` (steps of this episode), `time` (s), `plan_states`
(N, T + 1, 4) and `plan_controls` (N, T, 2), with T the planning horizon: the equilibrium of all
agents from `state` on that the others follow in the next step, zero beyond its `plan_stages` stages
(none where they play no equilibrium, and after the last step); `plan_solved` (whether it was solved
for at `state`; else it is what is left of an earlier one).

**Version history.** v0: first version.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from foresight_env.annotations import no_type_check
from foresight_env.envs.core import checks
from foresight_env.envs.core.behaviours import BehaviourFactory
from foresight_env.envs.core.parallel import WorldParallelEnv
from foresight_env.envs.core.single import SingleAgentEnv, single_metadata
from foresight_env.envs.crosswalk.world import crosswalk_world
from foresight_env.names import BehaviourName, Observation
from foresight_env.scenarios.crosswalk import DT, HORIZON, Proximity, Ranges


class CrosswalkParallelEnv(WorldParallelEnv):
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
        behaviour: BehaviourName | BehaviourFactory = "receding",
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
        world = crosswalk_world(count, variant, checks.check_ranges(ranges, Ranges))
        super().__init__(
            world,
            controlled=controlled,
            behaviour=behaviour,
            observation=observation,
            noise_std=noise_std,
            planning_horizon=planning_horizon,
            max_steps=max_steps,
            render_mode=render_mode,
        )


parallel_env = CrosswalkParallelEnv
"""The name that PettingZoo gives to parallel environments."""


class CrosswalkEnv(SingleAgentEnv):
    """Pedestrian 0 among others."""

    metadata: ClassVar[dict[str, Any]] = single_metadata(CrosswalkParallelEnv)  # type: ignore[misc]

    @no_type_check
    def __init__(self, **arguments: Any) -> None:
        super().__init__(CrosswalkParallelEnv, 0, arguments)
