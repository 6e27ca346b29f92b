"""One recorded window, two games: how well each explains it, and how well it predicts it.

The published game and the realistic one, with discount factors inferred and 1, and constant
velocity. *Fit*: the whole window is observed, and the trajectory of the fitted parameters compared
with it. *Prediction*: the first steps are observed, and the rest compared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from agents.interfaces.predictor import History
from agents.predictors.junction import JunctionPredictor, Noise
from evaluation.metrics.trajectory import displacement
from evaluation.studies import intersection as published
from evaluation.windows.intersection import Case, difference
from foresight_env.equilibrium import Status
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse import Estimate

GAMES = ("published", "realistic")
EVEN = Noise(*(published.LEAST_STD,) * 4, forgetting_factor=1.0)
"""Of the fit to a whole window: as the published game's, the same at all steps."""


class Comparison(NamedTuple):
    """One game with one method; constant velocity has no game."""

    game: str
    method: str
    fit_squared: float
    """`||X - X_recorded||^2` over all stages and observed entries of the states."""
    fit_displacement: float
    """Mean distance of the fitted trajectory from the recorded one, m."""
    average_error: float
    """ADE of the prediction, m."""
    final_error: float
    """FDE, m."""
    states: Float[np.ndarray, "K N 4"]
    """The prediction: `[px, py, vx, vy]` of people, `[px, py, v, psi]` of vehicles."""
    gamma: Float[np.ndarray, "N"] | None
    """Inferred from the whole window."""
    gamma_interval: Float[np.ndarray, "N 2"] | None
    gamma_identifiable: Bool[np.ndarray, "N"] | None
    unidentified: tuple[str, ...]
    """Free parameters that the whole window leaves open."""
    free: int
    """How many parameters were free."""
    fit_solved: bool
    """False where the fit failed: constant velocity is compared instead."""
    prediction_solved: bool


def compare(case: Case, known: int, parameters: str = "goals") -> list[Comparison]:
    """Return the comparison of both games on a window.

    Args:
        case: The window.
        known: Observed steps of the prediction.
        parameters: What is estimated of the published game, see `studies.intersection.PARAMETERS`.

    Raises:
        ValueError: `known` does not fit the window, see `studies.intersection.observed_steps`.
    """
    steps = len(case.states)
    published.observed_steps(known, steps, published.least_observed(case))
    everything = published.observe(case, "full", 0.0, 0, steps)
    seen = published.observe(case, "full", 0.0, 0, known)
    line = published.straight(case, everything)
    ahead = published.straight(case, seen, published.CONSTANT_VELOCITY_STEPS)
    found = []
    for game in GAMES:
        for method in ("infer-gamma", "assume-gamma-1"):
            if game == "published":
                whole = published.fit(case, "full", 0.0, 0, method, parameters)
                fitted = published.fit(case, "full", 0.0, 0, method, parameters, known)
                part = _Part(_states(fitted), int(fitted.status) == Status.SOLVED)
            else:
                whole = _fit_realistic(case, steps, method, EVEN)
                part = _predict_realistic(case, known, method)
            found.append(_judged(case, known, game, method, whole, part, line, ahead))
    found.append(_judged(case, known, "", "constant-velocity", None, None, line, ahead))
    return found


def history_of(case: Case, known: int) -> History:
    """The first `known` steps of a window as predictors are given them."""
    states = np.array(case.states[:known])
    headings = np.full(states.shape[:2], np.nan)
    for i, kind in enumerate(case.kinds):
        if is_vehicle(kind):
            speed, heading = states[:, i, 2].copy(), states[:, i, 3].copy()
            states[:, i, 2:] = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=1)
            headings[:, i] = heading
    extents = np.full((len(case.kinds), 2), np.nan)
    return History(states, headings, case.kinds, extents, case.dt)


class _Part(NamedTuple):
    """A prediction."""

    states: Float[np.ndarray, "K N 4"]
    solved: bool


def _predict_realistic(case: Case, known: int, method: str) -> _Part:
    """Prediction of `junction-game`; before, and of speeds and headings, its fit."""
    predictor = JunctionPredictor(infer=method == "infer-gamma")
    history, steps = history_of(case, known), len(case.states) - known
    found = predictor.fit(history, steps)
    forecast = predictor.forecast(history, steps, found)
    states = _states(found)
    states[known:, :, :2] = forecast.most_likely
    return _Part(states, not forecast.fallback)


def _fit_realistic(case: Case, known: int, method: str, noise: Noise) -> Estimate:
    predictor = JunctionPredictor(infer=method == "infer-gamma", noise=noise)
    return predictor.fit(history_of(case, known), len(case.states) - known)


def _unidentified(case: Case, found: Estimate) -> tuple[str, ...]:
    """Names of parameters that are not identifiable, initial states left out."""
    names = (
        f"{parameter.entry or parameter.kind} of {case.agents[parameter.player]}"
        for parameter, known in zip(found.parameters, found.identifiable, strict=True)
        if not known and parameter.kind != "initial_state"
    )
    return tuple(dict.fromkeys(names))  # an entry with two numbers once


def _states(found: Estimate) -> Float[np.ndarray, "K N 4"]:
    """Observed entries of the estimated states, all agents."""
    return np.stack([s[:, :4] for s in found.solution.states], axis=1)


def _judged(
    case: Case,
    known: int,
    game: str,
    method: str,
    whole: Estimate | None,
    part: _Part | None,
    line: Float[np.ndarray, "K N 4"],
    ahead: Float[np.ndarray, "K N 4"],
) -> Comparison:
    fitted = whole is not None and int(whole.status) == Status.SOLVED
    explained = _states(whole) if whole is not None and fitted else line
    predicted = part is not None and part.solved
    forecast = part.states if part is not None and predicted else ahead
    rest = slice(known, None)
    truth, present = case.states[..., :2], case.present
    inferred = fitted and method == "infer-gamma"
    return Comparison(
        game,
        method,
        float(np.sum(difference(case, explained) ** 2)),
        displacement(explained[..., :2], truth, present)[0],
        *displacement(forecast[rest, :, :2], truth[rest], present[rest]),
        forecast,
        whole.gamma if whole is not None and inferred else None,
        whole.gamma_interval if whole is not None and inferred else None,
        whole.gamma_identifiable if whole is not None and inferred else None,
        _unidentified(case, whole) if whole is not None and fitted else (),
        len(whole.parameters) if whole is not None else 0,
        fitted or whole is None,
        predicted or part is None,
    )
