"""The paper's study on recorded people and cars (section VI-B): estimation error over noise.

Noise is added to the recorded states. `infer-gamma` and `assume-gamma-1` get the same sequences and
start from the same parameters; `constant-velocity` is the best straight, even motion through them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from evaluation.execution.compilation import until_forgotten
from evaluation.execution.local import Workers
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store
from evaluation.metrics.trajectory import displacement
from evaluation.studies.estimation import OBSERVATIONS, noise_levels
from evaluation.windows.intersection import Case, Choice, difference, fitted_game, load
from foresight_env.equilibrium import Status
from foresight_env.games import ObservationModel, full_state, positions
from foresight_env.inverse import (
    Estimate,
    Free,
    MultiStart,
    Prior,
    estimate,
    guess_initial_state,
)
from foresight_env.scenarios.intersection import player_theta

KEY = ("observation", "std", "sequence", "method")
METHODS = ("infer-gamma", "assume-gamma-1", "constant-velocity")
PARAMETERS = {
    "goals": ("goal",),
    "all": (
        "goal",
        "goal_weight",
        "control_weight",
        "collision_weight",
        "collision_distance",
        "lane_weight",
    ),
}
"""Parameters of each player that are estimated in addition to its discount factor."""
WEIGHT_RANGE = (0.02, 100.0)
PRIOR = Prior(theta_deviation=(("goal", 20.0),))
ALL_PRIOR = Prior(
    theta_deviation=(
        ("goal", 20.0),
        ("goal_weight", 2.0),
        ("control_weight", 2.0),
        ("collision_weight", 2.0),
        ("collision_distance", 1.0),
        ("lane_weight", 10.0),
    )
)
"""Weights are believed to be near the published starts: their common scale changes nothing."""
LEAST_STD = 0.1
"""Deviation (m, m/s, rad) of observations at least: no game is an exact model of people, and fits
that believe so end in local minima (the project's own window, positions: error 2200, not 71)."""
STARTS = 8
"""Starts of a fit. With 4 that of noise-free positions of the project's own window ends where all
discount factors are 1 (error 3590), with 8 at one of 134."""


def model_of(observation: str, agents: int) -> ObservationModel:
    """Of agents with four states each."""
    return {"full": full_state, "positions": positions}[observation]((4,) * agents)


def observe(
    case: Case, observation: str, std: float, sequence: int, known: int
) -> Float[np.ndarray, "K size"]:
    """A noisy sequence, NaN where no agent was observed and after the first `known` steps."""
    random = np.random.default_rng([sequence, round(std * 1e6), OBSERVATIONS.index(observation)])
    noisy = case.states + std * random.standard_normal(case.states.shape)
    width = 4 if observation == "full" else 2
    # Later rows are missing, not cut off: one compiled estimator serves any number of them.
    noisy[known:] = np.nan
    return noisy[..., :width].reshape(len(noisy), -1)


def fit(
    case: Case, observation: str, std: float, sequence: int, method: str, parameters: str,
    known: int | None = None,
) -> Estimate:  # fmt: skip
    """One estimate from the first `known` steps (None: all); it covers the whole window."""
    steps = len(case.states)
    known = steps if known is None else known
    game = fitted_game(case, known, steps - 1)
    model = model_of(observation, len(case.agents))
    seen = observe(case, observation, std, sequence, known)
    theta, free = [], []
    for i, kind in enumerate(case.kinds):
        places = seen.reshape(steps, len(case.agents), -1)[:, i, :2]
        own = player_theta(kind, places[~np.isnan(places[:, 0])][-1])
        names = tuple(name for name in PARAMETERS[parameters] if name in own)
        limits = tuple((name, WEIGHT_RANGE) for name in names if name != "goal")
        theta.append(own)
        free.append(Free(names, method == "infer-gamma", True, theta_range=limits))
    return estimate(
        game,
        seen,
        model,
        initial_state=guess_initial_state(game, model, seen),
        theta=theta,
        gamma=1.0,
        free=free,
        covariance=max(std, LEAST_STD) ** 2,
        prior=PRIOR if parameters == "goals" else ALL_PRIOR,
        starts=MultiStart(STARTS),
    )


def straight(
    case: Case, seen: Float[np.ndarray, "K size"], fitted: int | None = None
) -> Float[np.ndarray, "K N 4"]:
    """All agents at constant velocity: least squares through the last `fitted` observations."""
    states = np.zeros((len(seen), len(case.agents), 4))
    places = seen.reshape(len(seen), len(case.agents), -1)[..., :2]
    for i, walks in enumerate(case.walks):
        rows = np.flatnonzero(~np.isnan(places[:, i, 0]))[-(fitted or len(seen)) :]
        velocity, start = np.zeros(2), places[rows[-1], i]
        if rows.size > 1:
            velocity, start = np.polyfit(rows * case.dt, places[rows, i], 1)
        times = case.dt * np.arange(len(seen))
        states[:, i, :2] = start + times[:, None] * velocity
        turned = [np.hypot(*velocity), np.arctan2(velocity[1], velocity[0])]
        states[:, i, 2:] = velocity if walks else turned
    return states


def by_agent(found: Estimate) -> Float[np.ndarray, "K N 4"]:
    """The estimated states, all players side by side."""
    return np.stack(found.solution.states, axis=1)


@until_forgotten
def warm_up(choice: Choice, observation: str, parameters: str) -> None:
    """Compile in this process what an estimate needs, so that times are those of running."""
    fit(load(choice), observation, 0.0, 0, "assume-gamma-1", parameters)


def run_sequence(
    observation: str, std: float, sequence: int, method: str, parameters: str, choice: Choice
) -> Row:
    """One method's row."""
    case = load(choice)
    steps = len(case.states)
    found: Estimate | None = None
    begin = time.perf_counter()
    if method == "constant-velocity":
        states = straight(case, observe(case, observation, std, sequence, steps))
    else:
        warm_up(choice, observation, parameters)
        begin = time.perf_counter()
        found = fit(case, observation, std, sequence, method, parameters)
        states = by_agent(found)
    seconds = time.perf_counter() - begin
    gap = difference(case, states)
    average, _ = displacement(states[..., :2], case.states[..., :2], case.present)
    row: Row = {
        "error_squared": float(np.sum(gap**2)),
        "average_displacement": average,
        "seconds": seconds,
        "solved": True,
        "agents": list(case.agents),
        "kinds": list(case.kinds),
        "gamma": [],
        "gamma_low": [],
        "gamma_high": [],
        "gamma_identifiable": [],
    }
    if found is not None:
        row["solved"] = int(found.status) == Status.SOLVED
    if found is not None and method == "infer-gamma":
        row["gamma"] = found.gamma.tolist()
        row["gamma_low"], row["gamma_high"] = (side.tolist() for side in found.gamma_interval.T)
        row["gamma_identifiable"] = found.gamma_identifiable.tolist()
    return row


def study(
    folder: str | Path,
    choice: Choice,
    levels: int,
    sequences: int,
    *,
    parameters: str = "goals",
    observations: Sequence[str] = OBSERVATIONS,
    workers: Workers = None,
) -> list[Row]:
    """Run the study in `folder`: noise levels x sequences x observation models x methods.

    Noise-free sequences are all the same: there is one. Trials that the folder has already are not
    run again.
    """
    told: dict[str, Any] = {
        name: str(getattr(choice, name)) for name in choice.__dataclass_fields__
    }
    told |= {"parameters": parameters, "starts": STARTS}
    store = Store(folder, "intersection", told, KEY)
    trials: list[dict[str, Any]] = [
        {
            "observation": o,
            "std": float(std),
            "sequence": k,
            "method": m,
            "parameters": parameters,
            "choice": choice,
        }
        for o in observations
        for std in noise_levels(levels)
        for k in range(sequences if std > 0.0 else 1)
        for m in METHODS
    ]
    return run_trials(
        run_sequence,
        trials,
        store,
        workers=workers,
        label="window",
        chunk=8,
        programs=("observation", "method"),
    )


CONSTANT_VELOCITY_STEPS = 5
LEAST_OBSERVED = 3
"""Observed steps that a prediction needs."""
MOST_OBSERVED = 15
"""Observed steps of a prediction, unless chosen; shorter windows begin it in their middle."""


def observed_steps(at: int | None, steps: int, least: int = LEAST_OBSERVED) -> int:
    """Return after how many of a window's steps the predictions begin.

    Args:
        at: Number of observed steps; None: half of the window, at most `MOST_OBSERVED`.
        steps: Steps of the window.
        least: Observed steps that predictions need.

    Raises:
        ValueError: `at` does not fit the window, or the window is too short for any.
    """
    if least >= steps:
        raise ValueError(
            f"--frames: the window has {steps} steps; predictions need at least {least + 1} (all "
            f"agents observed in the first {least})"
        )
    if at is None:
        return max(least, min(MOST_OBSERVED, steps // 2 + 1))
    if not least <= at < steps:
        raise ValueError(f"--at: is {at}; expected {least} to {steps - 1} observed steps")
    return at


def least_observed(case: Case) -> int:
    """Return the least number of first steps in which every agent is observed."""
    return max(LEAST_OBSERVED, int(case.present.argmax(axis=0).max()) + 1)
