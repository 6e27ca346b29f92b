"""Driving: cars of different foresight turn left, merge, change lanes and share a roundabout.

| Creation | `foresight_env.envs.driving_v0.parallel_env()` |
|---|---|
| By PettingZoo id | `pettingzoo.make("parallel", "foresight/driving-v0")` |
| Single agent | `gymnasium.make("foresight/Driving-v0")`, car 0 |
| Actions | continuous |
| Parallel API | yes |
| Agents | the controlled ones of `car_0`, `car_1`, ... |
| Action shape | (2,), float32 |
| Action values | acceleration -5 to 5 m/s^2, steering angle -0.6 to 0.6 rad |
| Observation shape | (4 N + 2,) or (2 N + 2,), float32 |

Every car has a journey: a path along the lanes of a road network, a target speed and a goal on the
path. Player i weighs what it pays t steps ahead with `gamma_i ** t`. The user controls some of
them; of the others each plays an equilibrium of the game between all (`scenarios.driving`), or is
one of highway-env's IDM/MOBIL vehicles, or follows a recorded track. No agent observes the discount
factors, journeys and weights of the others. Car 0 has the manoeuvre that the scene is named after:

- `left_turn`: an unprotected left turn at a four-arm crossing, among oncoming cars; 50 steps.
- `merge`: from the ramp onto highway-env's merging road, at 15 m/s; 80 steps.
- `lane_change`: from behind a slow car to the lane on the left, on three lanes; 80 steps.
- `roundabout`: highway-env's roundabout, from south to north; 150 steps.

**Motion.** highway-env's vehicle (kinematic bicycle with slip angle, 5 x 2 m, position in its
middle), in axes whose y points up. A step of `1 / policy_frequency` s holds the control and is
passed in `simulation_frequency / policy_frequency` Euler steps, as highway-env does. Cars drive at
0 to 30 m/s and do not reverse; the applied acceleration is the nearest that keeps the next speed
inside.

**Actions.** `[acceleration, steering angle]`, steering to the left above 0. Wrong actions raise
`ValueError` before anything changes: one missing, an unknown agent, a wrong shape, NaN, a value
outside the space.

**Observations.** `[px, py, v, psi]` of every car (`"full"`) or `[px, py]` (`"positions"`), in m,
m/s and rad: the agent itself first, then the others in the order of their indices, all with
independent Gaussian noise; then the agent's own goal `[gx, gy]`, exact. Headings are not wrapped.
What would lie outside the space is clipped.

**Rewards.** Minus the agent's own stage cost, nothing discounted:

    r_i = -(path_weight offset_i^2 + speed_weight (v_i' - target_speed_i)^2
            + control_weight a_i^2 + steering_weight steering_i^2
            + collision_weight sum max(0, collision_distance - d)^2
            + 50 (max(0, |offset_i| - 1))

with applied controls and reached states; `offset_i` (m) is from the own path, the sum goes over
the distances `d` (m) of the two discs that cover the agent to those of all others (`games.paths`).
An agent that maximises the return discounted by `gamma_i` plays the game of the others.

**End of an episode**, common to all agents. Terminated: a controlled agent collided (its 5 x 2 m
box overlaps another's at some moment of a step, in which all cars move straight on and turns
evenly; found to 1 cm), or left the road (its middle is more than 1 m outside every lane), or
every controlled agent has been within 4 m of its goal at the end of a step. Truncated: `max_steps`
without any of these. Afterwards `agents` is empty and `step` raises `gymnasium.error.ResetNeeded`.

**Arguments.**

- `scene="left_turn"`: or `"merge"`, `"lane_change"`, `"roundabout"`.
- `cars=4`: 2 to 6, in the order of `highway.scenes`.
- `controlled=(0,)`: indices of the cars that the user controls; None or `"all"`: all.
- `behaviour="receding"`: what the others do. `"receding"` solves the game of all cars, true
  parameters and true states, at every step; `"open_loop"` solves it once, over `max_steps` stages,
  and follows that plan; when a solve fails, the previous plan is followed, and without one they
  brake. `"idm"`: highway-env's IDM and MOBIL, which see who is ahead on their lane and no crossing
  traffic. Or a factory of a custom behaviour (module `core.behaviours`; `drivers.RecordedDrivers`
  follows tracks). Or a tuple with one of these per car.
- `observation="full"`: or `"positions"`.
- `noise_std=0.1`: standard deviation of the noise of every observed coordinate, m, m/s and rad.
- `ranges=DrivingRanges()`: from where an episode's hidden parameters are drawn, uniformly.
- `planning_horizon=11`: stages of the game that `"receding"` solves and that `scene` holds.
- `policy_frequency=10`, `simulation_frequency=20`: steps and Euler steps per second, Hz; the second
  is a multiple of the first.
- `max_steps=None`: steps until truncation; None: the scene's.
- `render_mode=None`: `"rgb_array"` or `"human"`.

**Options of `reset`**, each in place of what would be drawn: `"gamma"` (N,), at least 0, `"goals"`
(N, 2) m, `"initial_state"` (N, 4), `"episode_parameters"`, a whole
`scenarios.episode_parameters.EpisodeParameters`. Single entries win over `"episode_parameters"`.
Without a seed, `reset` continues the stream of the last one; an episode does not depend on how long
the ones before it took.

**Information** of each agent, and the only place of ground truth: `state` (N, 4), `gamma` (N,),
`theta` (`goal` (N, 2), `path` (N, M, 4), target speeds, weights and distances (N,)), `controls`
(N, 2) applied by all cars in the last step, `applied_action` (2,) of this agent, `min_distance`
(m; the smallest gap so far between its box and another's, negative where they overlapped),
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

from functools import partial
from typing import Any, ClassVar, Literal

from foresight_env.annotations import no_type_check
from foresight_env.envs.core import checks
from foresight_env.envs.core.behaviours import BEHAVIOURS, BehaviourFactory
from foresight_env.envs.core.parallel import WorldParallelEnv
from foresight_env.envs.core.single import SingleAgentEnv, single_metadata
from foresight_env.envs.driving.drivers import IdmDrivers, MixedDrivers
from foresight_env.envs.driving.world import driving_world
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.scenes import LEAST_CARS, MOST_CARS, SCENES, DrivingScene
from foresight_env.names import DrivingBehaviour, Observation, SceneName
from foresight_env.scenarios.driving import HORIZON

Driver = DrivingBehaviour | BehaviourFactory


class DrivingParallelEnv(WorldParallelEnv):
    """The driving scenes; the module's docstring is their page."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": "driving_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
        "is_parallelizable": True,
    }

    @no_type_check
    def __init__(
        self,
        scene: SceneName = "left_turn",
        cars: int = 4,
        controlled: tuple[int, ...] | Literal["all"] | None = (0,),
        behaviour: Driver | tuple[Driver, ...] = "receding",
        observation: Observation = "full",
        noise_std: float = 0.1,
        ranges: DrivingRanges = DrivingRanges(),
        planning_horizon: int = HORIZON,
        policy_frequency: int = 10,
        simulation_frequency: int = 20,
        max_steps: int | None = None,
        render_mode: Literal["human", "rgb_array"] | None = None,
    ) -> None:
        chosen = SCENES[checks.choice("scene", scene, tuple(SCENES))]
        count = checks.whole("cars", cars, LEAST_CARS, MOST_CARS)
        frequency = checks.whole("policy_frequency", policy_frequency, 1)
        substeps, left = divmod(
            checks.whole("simulation_frequency", simulation_frequency, frequency), frequency
        )
        if left:
            raise ValueError(
                f"simulation_frequency: is {simulation_frequency}; expected a multiple of "
                f"policy_frequency, {frequency}"
            )
        checked = checks.check_ranges(ranges, DrivingRanges)
        super().__init__(
            driving_world(chosen, count, checked, 1.0 / frequency, substeps),
            controlled=controlled,
            behaviour=_behaviour(chosen, behaviour, count),
            observation=observation,
            noise_std=noise_std,
            planning_horizon=planning_horizon,
            max_steps=chosen.max_steps if max_steps is None else max_steps,
            render_mode=render_mode,
        )


def _behaviour(scene: DrivingScene, behaviour: Any, cars: int) -> BehaviourFactory:
    """One factory for all cars."""
    if not isinstance(behaviour, tuple):
        return _driver(scene, "behaviour", behaviour)
    if len(behaviour) != cars:
        raise ValueError(f"behaviour: has {len(behaviour)} entries; expected one per car, {cars}")
    by_name: dict[Any, BehaviourFactory] = {}
    for i, driver in enumerate(behaviour):
        by_name.setdefault(driver, _driver(scene, f"behaviour[{i}]", driver))
    return partial(MixedDrivers, [by_name[driver] for driver in behaviour])


def _driver(scene: DrivingScene, name: str, driver: Any) -> BehaviourFactory:
    if callable(driver):
        factory: BehaviourFactory = driver
        return factory
    if checks.choice(name, driver, (*BEHAVIOURS, "idm")) == "idm":
        return partial(IdmDrivers, scene)
    return BEHAVIOURS[driver]


parallel_env = DrivingParallelEnv
"""The name that PettingZoo gives to parallel environments."""


class DrivingEnv(SingleAgentEnv):
    """Car 0, whose manoeuvre the scene is named after."""

    metadata: ClassVar[dict[str, Any]] = single_metadata(DrivingParallelEnv)  # type: ignore[misc]

    @no_type_check
    def __init__(self, **arguments: Any) -> None:
        super().__init__(DrivingParallelEnv, 0, arguments)
