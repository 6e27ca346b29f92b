"""Names of scenarios, driving scenes and choices, for environments, studies and the command line.

Loads nothing else, so that a command line can list them at once.
"""

from __future__ import annotations

from typing import Literal, get_args

Scenario = Literal["crosswalk", "intersection", "driving"]
"""Each is an environment: `foresight_env.envs.<name>_v0`."""
SceneName = Literal["left_turn", "merge", "lane_change", "roundabout"]
"""Road layouts of the scenario `driving`."""
Observation = Literal["full", "positions"]
"""Observed part of states: whole states, or positions alone."""
BehaviourName = Literal["receding", "open_loop"]
"""How uncontrolled agents play the game: re-planning at every step, or once at the start."""
DrivingBehaviour = Literal["receding", "open_loop", "idm"]
"""The same for cars, which highway-env's IDM/MOBIL may drive."""

SCENARIOS: tuple[str, ...] = get_args(Scenario)
SCENE_NAMES: tuple[str, ...] = get_args(SceneName)
OBSERVATIONS: tuple[str, ...] = get_args(Observation)
DRIVING_BEHAVIOURS: tuple[str, ...] = get_args(DrivingBehaviour)
PLACES: tuple[str, ...] = (*(name for name in SCENARIOS if name != "driving"), *SCENE_NAMES)
"""Environments by the names in results: scenarios, and scenes of the scenario `driving`."""
