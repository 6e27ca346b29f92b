"""Drivers of uncontrolled cars that play no game: highway-env's, and recorded tracks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from jaxtyping import Float

from foresight_env.envs.core.behaviours import (
    Behaviour,
    BehaviourFactory,
    BehaviourSetting,
    JointPlan,
    SolverReport,
)
from foresight_env.highway.axes import flipped_controls, flipped_states
from foresight_env.highway.scenes import DrivingScene
from foresight_env.scenarios.driving import ACCELERATION_LIMIT, STEERING_LIMIT
from foresight_env.scenarios.episode_parameters import EpisodeParameters


class _Planless:
    """Base of drivers without a solver and a plan."""

    report = SolverReport()
    planned: tuple[Float[np.ndarray, "K 2"], ...] | None = None

    def plan(self, states: Float[np.ndarray, "N n"]) -> None:
        """Return None: there is no plan."""


class IdmDrivers(_Planless):
    """highway-env's `IDMVehicle`, as it is: IDM along the lane, MOBIL to change it.

    They keep their distance from who is ahead on their lane and on the one they change to; crossing
    traffic they do not see. They decide once per step.
    """

    def __init__(self, scene: DrivingScene, setting: BehaviourSetting) -> None:
        self._scene = scene
        self._dt = setting.game(1).dt
        self._vehicles: list[IDMVehicle] = []

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Put all cars on the road, with its journey and target speed."""
        scene, states = self._scene, flipped_states(episode_parameters.initial_state)
        road = Road(scene.network, [], np_random=np.random.RandomState(0))
        self._vehicles = []
        for journey, state, theta in zip(
            scene.journeys, states, episode_parameters.theta, strict=False
        ):
            lane = road.network.get_closest_lane_index(state[:2], state[3])
            lanes = list(journey.lanes)
            vehicle = IDMVehicle(
                road,
                state[:2].copy(),
                float(state[3]),
                float(state[2]),
                target_lane_index=lane,
                target_speed=float(theta["target_speed"]),
                route=lanes[lanes.index(lane) :] if lane in lanes else lanes,
            )
            road.vehicles.append(vehicle)
            self._vehicles.append(vehicle)

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of every driver now."""
        for vehicle, state in zip(self._vehicles, flipped_states(states), strict=True):
            vehicle.position = state[:2].copy()
            vehicle.speed, vehicle.heading = float(state[2]), float(state[3])
            vehicle.timer += self._dt
            vehicle.on_state_update()
        controls = np.zeros((len(states), 2))
        for i, vehicle in enumerate(self._vehicles):
            vehicle.act()
            controls[i] = vehicle.action["acceleration"], vehicle.action["steering"]
        limits = np.array([ACCELERATION_LIMIT, STEERING_LIMIT])
        return np.clip(flipped_controls(controls), -limits, limits)


class RecordedDrivers(_Planless):
    """Cars that follow recorded tracks, whatever the others do; they brake where a track ends."""

    def __init__(self, tracks: Float[np.ndarray, "K N 2"], dt: float) -> None:
        """`tracks`: positions at every step, m; NaN for cars that are driven otherwise."""
        self._tracks, self._dt, self._step = tracks, dt, 0

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin at the tracks' first places."""
        self._step = 0

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Steer to the next place, at a speed that reaches the one after it."""
        limits = np.array([ACCELERATION_LIMIT, STEERING_LIMIT])
        controls = np.zeros((len(states), 2))
        ahead = self._tracks[self._step + 1 : self._step + 3]
        self._step += 1
        for i, state in enumerate(states):
            if len(ahead) < 2 or np.isnan(ahead[:, i]).any():
                controls[i, 0] = -state[2] / self._dt
                continue
            way, then = ahead[0, i] - state[:2], ahead[1, i] - ahead[0, i]
            controls[i, 0] = (np.hypot(*then) / self._dt - state[2]) / self._dt
            slip = np.arctan2(way[1], way[0]) - state[3]
            slip = np.mod(slip + np.pi, 2.0 * np.pi) - np.pi if np.hypot(*way) > 1e-6 else 0.0
            controls[i, 1] = np.arctan(2.0 * np.tan(np.clip(slip, -1.0, 1.0)))
        return np.clip(controls, -limits, limits)


class MixedDrivers:
    """Another behaviour for every car."""

    def __init__(self, factories: Sequence[BehaviourFactory], setting: BehaviourSetting) -> None:
        different: dict[int, Behaviour] = {id(f): f(setting) for f in factories}
        self._all = list(different.values())
        self._own = [different[id(f)] for f in factories]

    @property
    def report(self) -> SolverReport:
        """How the solves of those that solve went."""
        reports = [b.report for b in self._all if b.report.status != SolverReport().status]
        return reports[0] if reports else SolverReport()

    @property
    def planned(self) -> tuple[Float[np.ndarray, "K 2"], ...] | None:
        """Plans of those that have one; others' places are empty."""
        plans = [b.planned for b in self._own]
        if all(p is None for p in plans):
            return None
        nothing = np.zeros((0, 2))
        return tuple(nothing if p is None else p[i] for i, p in enumerate(plans))

    def plan(self, states: Float[np.ndarray, "N n"]) -> JointPlan | None:
        """Return the common plan where all have one behaviour; different ones share none."""
        return self._all[0].plan(states) if len(self._all) == 1 else None

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin an episode for all cars."""
        for behaviour in self._all:
            behaviour.reset(episode_parameters)

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Each car's controls from its own behaviour."""
        decided = {id(b): b.act(states.copy()) for b in self._all}
        return np.stack([decided[id(b)][i] for i, b in enumerate(self._own)])
