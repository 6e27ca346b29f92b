"""The paper's open-loop study: estimation error against observation noise on the crosswalk.

The same noisy sequence goes to both methods; discount factors start uniformly at random in [0, 1],
goals at the last observed position; the initial state is estimated too.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from evaluation.execution.compilation import until_forgotten
from evaluation.execution.local import Workers
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store
from evaluation.metrics.trajectory import trajectory_error
from foresight_env.equilibrium import Solution, Status, solve
from foresight_env.games import ObservationModel, full_state, positions
from foresight_env.inverse import (
    Estimate,
    Free,
    MultiStart,
    Posterior,
    Profile,
    cramer_rao,
    estimate,
    guess_initial_state,
)
from foresight_env.scenarios.crosswalk import MONTE_CARLO, Proximity, crosswalk_game, player_theta

KEY = ("observation", "std", "sequence", "method")
METHODS = ("infer-gamma", "assume-gamma-1")
OBSERVATIONS = ("full", "positions")
LEAST_STD = 1e-3
"""Noise (m) that noise-free sequences are fitted with: only the prior's share depends on it."""
POSTERIOR: dict[str, Posterior | None] = {"full": None, "positions": Posterior()}
"""Of `infer-gamma`: positions alone leave velocities and discount factors open, so that the mean of
the posterior is a better estimate of the trajectory than the best fit. Without noise there is
nothing to average over."""
FREE = {
    "infer-gamma": Free(("goal",), True, True),
    "assume-gamma-1": Free(("goal",), False, True),
}


def noise_levels(count: int) -> Float[np.ndarray, "count"]:
    """Standard deviations in even steps from 0 to 0.1, variances up to the paper's 0.01 m^2.

    The paper speaks of even steps of the variance; its published results have even deviations.
    """
    return np.linspace(0.0, 0.1, count)


def observation_model(observation: str) -> ObservationModel:
    """Of two double integrators."""
    return {"full": full_state, "positions": positions}[observation]((4, 4))


@lru_cache(maxsize=4)
def truth(proximity: Proximity) -> Solution:
    """The Monte Carlo setting's equilibrium."""
    game = crosswalk_game(2, proximity=proximity)
    setting = MONTE_CARLO
    return solve(game, setting.initial_state, setting.theta, setting.gamma, throw=True)


def joint(solution: Solution) -> Float[np.ndarray, "stages 8"]:
    """All players' states side by side."""
    return np.concatenate(solution.states, axis=1)


def estimated(found: Estimate) -> Float[np.ndarray, "stages 8"]:
    """The trajectory that an estimate stands for: the posterior's mean where there is one."""
    if found.mean is None:
        return joint(found.solution)
    return np.concatenate(found.mean.states, axis=1)


def observe(
    observation: str, std: float, sequence: int, proximity: Proximity
) -> tuple[Float[np.ndarray, "stages size"], Float[np.ndarray, "2"]]:
    """A noisy sequence, and the random discount factors that estimates start from."""
    model = observation_model(observation)
    columns = np.arange(8) if observation == "full" else np.array([0, 1, 4, 5])
    random = np.random.default_rng([sequence, round(std * 1e6), model.size])
    clean = joint(truth(proximity))[:, columns]
    return clean + std * random.standard_normal(clean.shape), random.uniform(0.0, 1.0, 2)


def fit(
    observation: str, std: float, sequence: int, method: str, proximity: Proximity = "soft",
    starts: int = 8, profile: Profile | None = None, posterior: Posterior | None = None,
) -> Estimate:  # fmt: skip
    """One estimate from one sequence."""
    game, model = crosswalk_game(2, proximity=proximity), observation_model(observation)
    seen, gamma = observe(observation, std, sequence, proximity)
    half = model.size // 2
    return estimate(
        game,
        seen,
        model,
        initial_state=guess_initial_state(game, model, seen),
        theta=[player_theta(seen[-1, i * half : i * half + 2]) for i in range(2)],
        gamma=gamma if method == "infer-gamma" else 1.0,
        free=FREE[method],
        covariance=max(std, LEAST_STD) ** 2,
        starts=MultiStart(starts),
        profile=profile,
        posterior=posterior,
    )


@until_forgotten
def warm_up(observation: str, proximity: Proximity) -> None:
    """Compile in this process what an estimate needs, so that times are those of running."""
    fit(observation, 0.0, 0, "assume-gamma-1", proximity, 1)


def gamma_covered(found: Estimate) -> Bool[np.ndarray, "2"]:
    """Which intervals hold the true discount factor."""
    low, high = found.gamma_interval.T
    return (low <= MONTE_CARLO.gamma) & (MONTE_CARLO.gamma <= high)


def run_sequence(
    observation: str, std: float, sequence: int, method: str, proximity: Proximity, starts: int
) -> Row:
    """One estimate's row."""
    warm_up(observation, proximity)
    begin = time.perf_counter()
    averages = method == "infer-gamma" and std > LEAST_STD
    posterior = POSTERIOR[observation] if averages else None
    found = fit(observation, std, sequence, method, proximity, starts, posterior=posterior)
    seconds = time.perf_counter() - begin
    true = joint(truth(proximity))
    return {
        "error_squared": trajectory_error(estimated(found), true),
        "equilibrium_error_squared": trajectory_error(joint(found.solution), true),
        "solved": int(found.status) == Status.SOLVED,
        "cost": float(found.cost),
        "gamma": (found.gamma if found.mean is None else found.mean.gamma).tolist(),
        "gamma_deviation": found.gamma_deviation.tolist(),
        "gamma_covered": gamma_covered(found).tolist(),
        "gamma_identifiable": found.gamma_identifiable.tolist(),
        "solves": int(found.num_forward_solves),
        "seconds": seconds,
    }


def study(
    folder: str | Path,
    levels: int,
    sequences: int,
    *,
    observations: Sequence[str] = OBSERVATIONS,
    proximity: Proximity = "soft",
    starts: int = 8,
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the study in `folder`: noise levels x sequences x observation models x methods.

    Trials that the folder has already are not run again, unless `fresh`.
    """
    told = {name: str(setting) for name, setting in POSTERIOR.items()}
    configuration = {"proximity": proximity, "starts": starts, "posterior": told}
    store = Store(folder, "estimation", configuration, KEY, fresh=fresh)
    trials: list[dict[str, Any]] = [
        {
            "observation": o,
            "std": float(std),
            "sequence": k,
            "method": m,
            "proximity": proximity,
            "starts": starts,
        }
        for o in observations
        for std in noise_levels(levels)
        for k in range(sequences)
        for m in METHODS
    ]
    return run_trials(
        run_sequence,
        trials,
        store,
        workers=workers,
        label="estimation",
        chunk=16,
        programs=("observation", "method"),
    )


@lru_cache(maxsize=8)
def bound(observation: str, proximity: Proximity = "soft") -> float:
    """Cramer-Rao bound of the trajectory error per unit of noise variance (14 parameters)."""
    setting = MONTE_CARLO
    return float(
        cramer_rao(
            crosswalk_game(2, proximity=proximity),
            observation_model(observation),
            initial_state=setting.initial_state,
            theta=setting.theta,
            gamma=setting.gamma,
            free=FREE["infer-gamma"],
        ).trajectory
    )
