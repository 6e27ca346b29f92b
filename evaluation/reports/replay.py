"""An episode as plain numbers, for a reader who steps through it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from evaluation.reports.naming import label_of
from evaluation.rollout.endings import ending
from evaluation.rollout.episode import Step, inferred, observed_states, run_episode
from evaluation.rollout.setting import RunSetting
from foresight_env.envs.rendering.scenery import Disc
from foresight_env.envs.rendering.style import COLOURS, INTERVAL_DEVIATIONS, Colour
from foresight_env.games import Vehicle

DIGITS = 3
"""Of metres and discount factors in a replay."""


@dataclass(frozen=True)
class Replay:
    """Data of an episode for drawing on a page: JSON-ready, metres and seconds."""

    title: str
    ended: str
    data: dict[str, Any]


def replay(ego: str, seed: int, setting: RunSetting, title: str) -> Replay:
    """Run an episode again, which its seed determines, and keep every step.

    True states, what the ego saw, what it predicted and planned, and its estimates of the others'
    discount factors with 90 % intervals.
    """
    env = setting.make()
    found = run_episode(setting, ego, seed, env)
    scene, last, steps = found.scene, found.last, found.steps
    own = scene.controlled[0]
    width = len(steps[0].state[0]) if scene.observation == "full" else 2
    turning = [isinstance(p.dynamics, Vehicle) for p in scene.game.players]
    data = {
        "dt": scene.dt,
        "names": list(scene.names),
        "colours": [_hex(COLOURS[i]) for i in range(scene.players)],
        "ego": own,
        "infers": any(inferred(ego, s.decision) for s in steps),
        "footprints": [[f.length, f.width, f.radius] for f in env.world.footprints],
        "scenery": _scenery(env.world.scenery),
        "goals": [_short(theta) for theta in last["theta"]["goal"]],
        "gamma": _short(setting.true_gammas(last)),
        "steps": [_step(s, ego, own, width, turning) for s in steps],
        "final": _places(last["state"], turning),
    }
    summary = (
        f"{ending(last)} after {last['time']:.1f} s, smallest gap {last['min_distance']:.2f} m"
    )
    return Replay(f"{title}: {label_of(ego)}, seed {seed}", summary, data)


def _step(step: Step, ego: str, own: int, width: int, turning: list[bool]) -> dict[str, Any]:
    seen = observed_states(step.observation[None], own, len(turning), width)[0, :, :2]
    decision = step.decision
    gammas = inferred(ego, decision)
    return {
        "state": _places(step.state, turning),
        "seen": _short(seen),
        "planned": [] if decision.planned is None else _short(decision.planned),
        "predicted": {str(j): _short(path) for j, path in decision.predicted.items()},
        "gammas": {
            str(j): _short(np.array([mean, INTERVAL_DEVIATIONS * deviation]))
            for j, (mean, deviation) in gammas.items()
        },
        "failed": bool(decision.plan_fallback or decision.estimate_outdated),
    }


def _places(states: Float[np.ndarray, "N n"], turning: list[bool]) -> list[list[float]]:
    """Positions and headings; of those who do not turn, 0."""
    headings = np.where(turning, states[:, 3], 0.0)
    return _short(np.column_stack([states[:, :2], headings]))


def _scenery(scenery: Any) -> dict[str, Any]:
    shapes = [
        {"disc": [*shape.center, shape.radius], "colour": _hex(shape.colour)}
        if isinstance(shape, Disc)
        else {"corners": _short(np.array(shape.corners)), "colour": _hex(shape.colour)}
        for shape in scenery.shapes
    ]
    return {
        "center": list(map(float, scenery.center)),
        "half": float(scenery.half_width),
        "shapes": shapes,
    }


def _short(values: Any) -> Any:
    """Nested lists of rounded numbers; null where there is none."""
    rounded = np.round(np.asarray(values, dtype=float), DIGITS)
    found = rounded.astype(object)
    found[~np.isfinite(rounded)] = None
    return found.tolist()


def _hex(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
