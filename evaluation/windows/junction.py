"""The intersection game's setting of a recorded window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foresight_env.datasets import Window
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.motion import driving_state
from foresight_env.games.roads import Lane
from foresight_env.scenarios.intersection import IntersectionInstance, Region

STANDING = 2.0
"""A car that comes no farther than this within a window has no lane to be fitted, m."""


def recorded_setting(
    window: Window, region: Region = Region(), lanes: Sequence[Lane | None] | None = None
) -> IntersectionInstance:
    """The setting of a recorded window: states where it begins, goals where each is seen last.

    Args:
        window: every agent is observed in its first frame.
        region: what is forbidden there.
        lanes: per agent; None fits each car's lane to its own track in the window, which gives a
            predictor where the car will go: pass lanes fitted to earlier traffic for predictions.

    Raises:
        ValueError: `lanes` of another length, an agent missing in the first frame, a car standing
            there with no heading stated, or a track that no lane fits.
    """
    if lanes is not None and len(lanes) != len(window.agents):
        raise ValueError(
            f"lanes: has {len(lanes)} entries; expected one per agent, {len(window.agents)}"
        )
    missing = [a for a, seen in zip(window.agents, window.present[0], strict=True) if not seen]
    if missing:
        raise ValueError(
            f"window: {', '.join(missing)} not seen in its first frame, {window.frames[0]}; begin "
            "it where all agents are present"
        )
    last = [int(np.flatnonzero(seen)[-1]) for seen in window.present.T]
    places = window.states[:, :, :2]
    goals = np.stack([places[k, i] for i, k in enumerate(last)])
    cars = [i for i, kind in enumerate(window.kinds) if is_vehicle(kind)]
    states = np.array(window.states[0])
    for i in cars:
        heading = float(window.headings[0, i])
        if not (np.isfinite(heading) or states[i, 2:].any()):
            raise ValueError(
                f"window: {window.agents[i]} stands in its first frame and the recording states no "
                "heading; begin it where the car moves"
            )
        states[i] = driving_state(states[i], heading)
    if lanes is None:
        lanes = [_own_lane(window, i) if i in cars else None for i in range(len(window.kinds))]
    return IntersectionInstance(window.kinds, tuple(lanes), region, states, goals)


def _own_lane(window: Window, agent: int) -> Lane | None:
    places = window.states[window.present[:, agent], agent, :2]
    if np.hypot(*(places[-1] - places[0])) < STANDING:
        return None
    try:
        return Lane.fit(places)
    except ValueError as error:
        raise ValueError(
            f"window: no lane fits the track of {window.agents[agent]}: {error}"
        ) from None
