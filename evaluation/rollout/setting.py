"""Setting of `foresight run`: an environment of any scenario, with the ego's agent controlled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from evaluation.rollout.surprises import SURPRISES
from foresight_env.envs import crosswalk_v0, driving_v0, intersection_v0
from foresight_env.envs.core.behaviours import BehaviourFactory
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.scenes import SCENES
from foresight_env.scenarios.driving import DT as DRIVING_STEP

EGO_GAMMA = 0.95
"""The ego's own discount factor: a robot that looks ahead."""
OTHERS_GAMMA = (0.3, 1.0)
"""Range of the others' discount factors at the crosswalk and the intersection."""
MAX_STEPS = 100
"""Steps after which an episode at the crosswalk is truncated."""
NO_TRUTH = ("social-force", "gamma-change")
"""Surprises under which others have no discount factor, or none for the whole episode."""
EGO_CAR = 0
"""The ego's in driving, whose manoeuvre the scene is named after."""


@dataclass(frozen=True)
class RunSetting:
    """One episode's environment."""

    scenario: str = "crosswalk"
    """Or `"recorded"`, whose environments `evaluation.windows.replay` makes."""
    scene: str = "left_turn"
    """Of driving; other scenarios have one."""
    players: int | None = None
    """None: the scenario's usual number; the intersection has two pedestrians and two cars."""
    observation: str = "full"
    noise_std: float | None = None
    """None: the scenario's."""
    behaviour: str = "receding"
    others_gamma: tuple[float, float] | None = None
    """Range of the others' discount factors; None: the scenario's."""
    planning_horizon: int | None = None
    """Stages of all agents' plans; None: the scenario's."""
    step: float | None = None
    """Duration of a step in driving, s; None: the scenario's. Episodes last as long."""
    safety_filter: bool = True
    """Whether the ego's actions pass the safety filter (`agents.egos.safety_filter`)."""
    surprise: str = "none"
    """Unexpected behaviour of others, or of the sensors (`rollout.surprises`)."""

    def __post_init__(self) -> None:
        if self.behaviour == "idm" and self.scenario != "driving":
            raise ValueError("--behaviour: idm drives cars of the scenario driving only")
        if self.step is not None and self.scenario != "driving":
            raise ValueError(f"step: is {self.step}; only steps of the scenario driving can differ")
        if self.surprise not in SURPRISES:
            raise ValueError(
                f"surprise: {self.surprise!r} is unknown; choose from {', '.join(SURPRISES)}"
            )
        if self.scenario not in SURPRISES[self.surprise].scenarios:
            raise ValueError(
                f"surprise: {self.surprise!r} does not occur in the scenario {self.scenario}"
            )
        if self.behaviour != "receding" and SURPRISES[self.surprise].behaviour != "receding":
            raise ValueError(
                f"surprise: {self.surprise!r} has a behaviour; expected behaviour 'receding', not "
                f"{self.behaviour!r}"
            )
        if self.scenario == "intersection" and self.players is not None:
            raise ValueError("--players: the intersection has two pedestrians and two cars")

    @property
    def gammas(self) -> tuple[float, float]:
        """Between which the others' discount factors lie."""
        if self.others_gamma is not None:
            return self.others_gamma
        return DrivingRanges().gamma if self.scenario == "driving" else OTHERS_GAMMA

    def true_gammas(self, info: Mapping[str, Any]) -> Float[np.ndarray, "N"]:
        """Every agent's discount factor by an environment's `info`.

        NaN of agents that have none, as highway-env's vehicles, or not the same all the time.
        """
        found = np.array(info["gamma"], dtype=float)
        if "idm" in (self.behaviour, self.behaviour_of_others) or self.surprise in NO_TRUTH:
            found[EGO_CAR + 1 :] = np.nan
        return found

    @property
    def behaviour_of_others(self) -> str | BehaviourFactory:
        """Behaviour of the uncontrolled agents."""
        surprising = SURPRISES[self.surprise].behaviour
        return self.behaviour if surprising == "receding" else surprising

    @property
    def middle(self) -> float:
        """Time (s) at which agents are about to meet, for a still picture."""
        return {"crosswalk": 1.4, "intersection": 1.9, "driving": 2.0}[self.scenario]

    def make(self, render_mode: str | None = None) -> Any:
        """The environment; `ValueError` where it is that of a recording."""
        if self.scenario == "recorded":
            raise ValueError("scenario: is 'recorded'; make an evaluation.windows.replay.ReplayEnv")
        arguments: dict[str, Any] = {
            "observation": self.observation,
            "behaviour": self.behaviour_of_others,
            "render_mode": render_mode,
        }
        if self.noise_std is not None:
            arguments["noise_std"] = self.noise_std
        if self.planning_horizon is not None:
            arguments["planning_horizon"] = self.planning_horizon
        if self.scenario == "intersection":
            return intersection_v0.parallel_env(**arguments)
        if self.scenario == "driving":
            if self.players is not None:
                arguments["cars"] = self.players
            if self.step is not None:
                arguments["policy_frequency"] = round(1.0 / self.step)
                steps = SCENES[self.scene].max_steps * DRIVING_STEP / self.step
                arguments["max_steps"] = round(steps)
            return driving_v0.parallel_env(scene=self.scene, **arguments)  # type: ignore[arg-type]
        players = 2 if self.players is None else self.players
        return crosswalk_v0.parallel_env(
            players=players, controlled=(0,), max_steps=MAX_STEPS, **arguments
        )
