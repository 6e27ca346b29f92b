"""Metrics of a forecast: displacement errors, likelihood, predicted collisions."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from evaluation.metrics.calibration import level_counts
from evaluation.metrics.trajectory import (
    best_displacement,
    displacement,
    displacement_until,
    lateral_acceleration,
    missed,
    negative_log_likelihood,
)
from foresight_env.games.footprints import Footprint, Motion, least_gap
from foresight_env.games.kinds import body_radius, is_vehicle, kind_of

SECONDS = (1.0, 2.0, 3.0, 4.0)
"""Times ahead of displacement errors."""
MODES = 5
"""Of how many of the most likely futures the best counts, as in most benchmarks (nuScenes)."""
STANDING = 0.05
"""An agent that moves less than this in a step keeps its heading, m."""


def footprint(kind: str, extent: Float[np.ndarray, "2"]) -> Footprint:
    """Footprint of an agent: a box for vehicles, of usual size if none is stated, else a disc."""
    if not is_vehicle(kind):
        return Footprint(radius=body_radius(kind))
    usual = kind_of(kind)
    stated = np.where(extent > 0.0, extent, (usual.length, usual.width))
    return Footprint(float(stated[0]), float(stated[1]))


def overlaps(history: History, positions: Float[np.ndarray, "P N 2"]) -> int:
    """Pairs whose footprints overlap at a step or on the way to it; vehicles head where they go.

    Steps that lead to NaN do not count. Boxes turn evenly during a step.
    """
    shapes = [footprint(k, e) for k, e in zip(history.kinds, history.extents, strict=True)]
    tracks = [_motions(history, i, positions[:, i]) for i in range(len(shapes))]
    return sum(
        any(
            least_gap(shapes[i], shapes[j], tracks[i][k], tracks[j][k]) < 0.0
            for k in _near_steps(tracks[i], tracks[j], shapes[i].reach + shapes[j].reach)
        )
        for i, j in combinations(range(len(shapes)), 2)
    )


def _near_steps(first: list[Motion], second: list[Motion], reach: float) -> list[int]:
    """Steps in which two positions may come within `reach`; none that begins or ends with NaN.

    Every point of a line is at most half of its length from one of its ends.
    """
    start, end = (
        np.array([getattr(b, side) - getattr(a, side) for a, b in zip(first, second, strict=True)])
        for side in ("start", "end")
    )
    away = np.minimum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1))
    way = np.linalg.norm(end - start, axis=1)
    return [int(k) for k in np.flatnonzero(away - 0.5 * way < reach)]


def _motions(history: History, agent: int, path: Float[np.ndarray, "P 2"]) -> list[Motion]:
    """The agent's steps, from where it was last observed."""
    last = history.seen(agent)[-1]
    place, velocity = history.states[last, agent, :2], history.states[last, agent, 2:]
    heading = float(history.headings[last, agent])
    if np.isnan(heading):
        heading = float(np.arctan2(velocity[1], velocity[0]))
    found = []
    for after in path:
        way = after - place
        aim = float(np.arctan2(way[1], way[0])) if np.hypot(*way) > STANDING else heading
        turn = float(np.mod(aim - heading + np.pi, 2.0 * np.pi) - np.pi)
        found.append(Motion(place, after, heading, turn))
        place, heading = after, heading + turn
    return found


def judged(
    history: History, truth: Float[np.ndarray, "P N 2"], forecast: Forecast
) -> dict[str, Any]:
    """Return a forecast's metrics, of the most likely future unless the name says otherwise.

    Args:
        history: What the predictor was given.
        truth: Positions of the predicted steps, m; NaN where an agent is absent.
        forecast: Of the same agents and steps.
    """
    path, present = forecast.most_likely, ~np.isnan(truth[..., 0])
    average, final = displacement(path, truth, present)
    row: dict[str, Any] = {
        "average_error": average,
        "final_error": final,
        "missed": int(missed(path, truth, present).sum()),
        "overlaps": overlaps(history, np.where(present[..., None], path, np.nan)),
        "overlaps_recorded": overlaps(history, truth),
        "fallback": forecast.fallback,
        "agent_errors": [
            displacement(path[:, [i]], truth[:, [i]], present[:, [i]])[0]
            for i in range(truth.shape[1])
        ],
        "gamma": [] if forecast.gamma is None else forecast.gamma.tolist(),
    }
    last = [history.states[history.seen(i)[-1], i, :2] for i in range(truth.shape[1])]
    for name, positions in (("predicted", path), ("recorded", truth)):
        row[f"agent_lateral_{name}"] = [
            lateral_acceleration(positions[:, i], last[i], history.dt) for i in range(len(last))
        ]
    best = best_displacement(forecast.positions, forecast.probabilities, truth, present, MODES)
    row["best_average_error"], row["best_final_error"] = best
    row["nll"] = row["levels"] = None
    if forecast.covariance is not None:
        row["levels"] = level_counts(
            forecast.positions, forecast.probabilities, forecast.covariance, truth, present
        )
        row["nll"] = negative_log_likelihood(
            forecast.positions, forecast.probabilities, forecast.covariance, truth, present
        )
    for seconds in SECONDS:
        until = displacement_until(path, truth, present, history.dt, seconds)
        row[f"ade_{seconds:g}"], row[f"fde_{seconds:g}"] = until
        each = [
            displacement_until(path[:, [i]], truth[:, [i]], present[:, [i]], history.dt, seconds)
            for i in range(truth.shape[1])
        ]
        for name, values in zip(("ade", "fde"), zip(*each, strict=True), strict=True):
            row[f"agent_{name}_{seconds:g}"] = list(values)
    return row
