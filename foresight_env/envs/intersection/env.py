"""Intersection: cars and pedestrians of different foresight meet at the paper's junction in Aachen.

| Creation | `foresight_env.envs.intersection_v0.parallel_env()` |
|---|---|
| By PettingZoo id | `pettingzoo.make("parallel", "foresight/intersection-v0")` |
| Single agent | `gymnasium.make("foresight/Intersection-v0")`, the car that turns |
| Actions | continuous |
| Parallel API | yes |
| Agents | the controlled ones of `pedestrian_0`, `pedestrian_1`, `car_2`, `car_3` |
| Action shape | (2,), float32 |
| Action values | pedestrians: -5 to 5 m/s^2; cars: -5 to 5 m/s^2 and -pi/4 to pi/4 rad |
| Observation shape | (4 N + 2,) or (2 N + 2,), float32 |

Two people finish crossing the western arm, a car turns into that arm, another drives straight on
behind it: the published episode. With more agents two people come the other way, a car
comes from the south and one from the west. Player i weighs what it pays t steps ahead with `gamma_i
** t`. The user controls some of them; the others play an equilibrium of the game between all
(`scenarios.junction`). The discount factors, goals and weights of the others are hidden.

**Motion.** 0.24 s per step, as in the recording. Pedestrians are double integrators with at most
3 m/s per axis. Cars are kinematic bicycles (forward Euler, wheelbase 2.7 m) that drive at 0 to 20
m/s and do not reverse. The applied control is the nearest that keeps the next velocity inside.

**Actions.** Pedestrians `[ax, ay]`, cars `[acceleration, steering angle]`. Wrong actions raise
`ValueError` before anything changes: one missing, an unknown agent, a wrong shape, NaN, a value
outside the space.

**Observations.** Of each pedestrian `[px, py, vx, vy]` and of each car `[px, py, v, psi]`
(`"full"`), or `[px, py]` of all (`"positions"`), in m, m/s and rad: the agent itself first,
then the others in the order of their indices, all with independent Gaussian noise; then the
agent's own goal `[gx, gy]`, exact. Headings are not wrapped. What would lie outside the space is
clipped.

**Rewards.** Minus the agent's own stage cost, nothing discounted:

    r_i = -(goal_weight |p_i' - goal_i|^2 + control_weight |u_i|^2
            + collision_weight sum_j sigmoid(10 (collision_distance - |p_i' - p_j'|))
            + lane_weight offset_i^2 + 100 beside_i)

with applied controls `u`, reached positions `p'` and the agent's own weights. Pedestrians count
cars among the j, cars count all agents; only cars have a lane, from whose centre line `offset_i`
is. By `beside_i` the region's constraints are violated, which are elastic here: for each corner
`radius^2 - distance^2` (m^2; pedestrians: 0.3 of the radius) and, for cars, the distance from
each road side (m). An agent that maximises the return discounted by `gamma_i` plays the game of
the others.

**End of an episode**, common to all agents. Terminated: a controlled agent collided (its
footprint overlaps another's at some moment of a step, in which all agents move straight on and
turns evenly; found to 1 cm; pedestrians are discs of 0.25 m radius, cars boxes of 4.5 x 1.8 m
around their position; two pedestrians may touch), or left the road by more than 0.1 m
(pedestrians only when inside a corner), or every controlled agent has been near its goal at the
end of a step: within 1 m, cars within 3 m. Truncated: `max_steps` without any of these.
Afterwards `agents` is empty and `step` raises `gymnasium.error.ResetNeeded`.

**Arguments.**

- `pedestrians=2`, `cars=2`: how many of each, 1 to 4. Pedestrians are the first players.
- `controlled="first car"`: indices of those that the user controls; or `"first car"`, `None` or
  `"all"` for all.
- `behaviour="receding"`: what the others do. `"receding"` solves the game of all players, true
  parameters and true states, at every step; `"open_loop"` solves it once, over `max_steps` stages,
  and follows that plan. When a solve fails, the previous plan is followed;
  without one, the others brake to rest. Or a factory of a custom behaviour (module
  `core.behaviours`).
- `observation="full"`: or `"positions"`.
- `noise_std=0.05`: standard deviation of the noise of every observed coordinate, m, m/s and rad.
- `ranges=JunctionRanges()`: from where an episode's hidden parameters are drawn, uniformly.
- `planning_horizon=15`: stages of the game that `"receding"` solves and that `scene` holds.
- `max_steps=30`: steps until truncation.
- `render_mode=None`: `"rgb_array"` or `"human"`.

**Options of `reset`**, each in place of what would be drawn: `"gamma"` (N,), at least 0, `"goals"`
(N, 2) m, `"initial_state"` (N, 4), `"episode_parameters"`, a whole
`scenarios.episode_parameters.EpisodeParameters`. Single entries win over `"episode_parameters"`.
Without a seed, `reset` continues the stream of the last one; an episode does not depend on how long
the ones before it took.

**Information** of each agent, and the only place of ground truth: `state` (N, 4), `gamma` (N,),
`theta` (`goal` (N, 2), distances and weights (N,), 0 where a player has none), `controls` (N,
2) applied by all agents in the last step, `applied_action` (2,) of this agent, `min_distance` (m;
the smallest gap so far between its footprint and another's, negative where they overlapped),
`collision` and `off_road` (of this agent), `goal_reached`, `is_success` (goal reached, no
collision, on the road), `solver_status` (`equilibrium.Status`; -1 while nothing was solved),
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
from foresight_env.envs.intersection.world import intersection_world
from foresight_env.names import BehaviourName, Observation
from foresight_env.scenarios.intersection import DT
from foresight_env.scenarios.junction import HORIZON, MOST, JunctionRanges

PEDESTRIANS = 2
CARS = 2


class IntersectionParallelEnv(WorldParallelEnv):
    """The intersection; the module's docstring is its page."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": "intersection_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": round(1.0 / DT),
        "is_parallelizable": True,
    }

    @no_type_check
    def __init__(
        self,
        pedestrians: int = PEDESTRIANS,
        cars: int = CARS,
        controlled: tuple[int, ...] | Literal["first car", "all"] | None = "first car",
        behaviour: BehaviourName | BehaviourFactory = "receding",
        observation: Observation = "full",
        noise_std: float = 0.05,
        ranges: JunctionRanges = JunctionRanges(),
        planning_horizon: int = HORIZON,
        max_steps: int = 30,
        render_mode: Literal["human", "rgb_array"] | None = None,
    ) -> None:
        walking = checks.whole("pedestrians", pedestrians, 1, MOST)
        driving = checks.whole("cars", cars, 1, MOST)
        super().__init__(
            intersection_world(walking, driving, checks.check_ranges(ranges, JunctionRanges)),
            controlled=(walking,) if controlled == "first car" else controlled,
            behaviour=behaviour,
            observation=observation,
            noise_std=noise_std,
            planning_horizon=planning_horizon,
            max_steps=max_steps,
            render_mode=render_mode,
        )


parallel_env = IntersectionParallelEnv
"""The name that PettingZoo gives to parallel environments."""


class IntersectionEnv(SingleAgentEnv):
    """The first car, which turns, among others."""

    metadata: ClassVar[dict[str, Any]] = single_metadata(IntersectionParallelEnv)  # type: ignore[misc]

    @no_type_check
    def __init__(self, pedestrians: int = PEDESTRIANS, **arguments: Any) -> None:
        arguments = {"pedestrians": pedestrians, **arguments}
        super().__init__(IntersectionParallelEnv, pedestrians, arguments)
