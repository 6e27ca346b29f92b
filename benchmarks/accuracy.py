"""Accuracy of the estimator: noise-free recovery, the Cramer-Rao bound, the reference's number."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.report import Result, Row, Setting
from evaluation import estimation
from evaluation.estimation import LEAST_STD, OBSERVATIONS, bound, joint, observation_model, truth
from evaluation.metrics import trajectory_error
from evaluation.statistics import mean_interval
from evaluation.store import Row as Trial
from foresight_env.inverse import Free, MultiStart, Prior, estimate
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

RECOVERED = 1e-6
"""Trajectory error below which a noise-free estimate counts as exact."""
REFERENCE_ERROR = 0.765
"""Error of the reference implementation's best gamma = 1 fit, from its own description."""


def reference_error() -> float:
    """The same quantity here: reference cost, x_1 known, no noise, gamma = 1, goals fitted."""
    game, setting = crosswalk_game(2, proximity="reference"), MONTE_CARLO
    true = joint(truth("reference"))
    found = estimate(
        game,
        true,
        observation_model("full"),
        initial_state=setting.initial_states,
        theta=setting.theta,
        gamma=1.0,
        free=Free(("goal",), False, False),
        covariance=1.0,
        prior=Prior(gamma_weight=0.0),
        starts=MultiStart(1),
    )
    return trajectory_error(joint(found.solution), true)


def noise_free(rows: list[Trial]) -> list[Row]:
    """Share of exact recoveries from random discount factors."""
    lines: list[Row] = []
    for observation in OBSERVATIONS:
        errors = np.array(
            [
                r["error_squared"] if not r["error"] else np.inf
                for r in rows
                if (r["observation"], r["std"], r["method"]) == (observation, 0.0, "foresight")
            ]
        )
        lines.append(
            {
                "observed": observation,
                "sequences": str(errors.size),
                f"error below {RECOVERED:.0e}": f"{np.mean(errors < RECOVERED):.1%}",
                "largest error": float(errors.max()),
            }
        )
    return lines


def against_bound(rows: list[Trial]) -> list[Row]:
    """Mean error over the Cramer-Rao bound per noise level, and the gamma = 1 baseline."""
    lines: list[Row] = []
    for observation in OBSERVATIONS:
        for std in sorted({r["std"] for r in rows if r["std"] > LEAST_STD}):
            limit = bound(observation) * std**2
            mine = [r for r in rows if (r["observation"], r["std"]) == (observation, std)]
            told = {}
            for method in estimation.METHODS:
                good = [r for r in mine if r["method"] == method and not r["error"]]
                ratio = np.array([r["error_squared"] for r in good]) / limit
                told[method] = mean_interval(ratio)
            covered = [
                c for r in mine if r["method"] == "foresight" and not r["error"]
                for c in r["gamma_covered"]
            ]  # fmt: skip
            own = told["foresight"]
            lines.append(
                {
                    "observed": observation,
                    "noise std [m]": f"{std:.3f}",
                    "error / bound": f"{own.mean:.2f} [{own.low:.2f}, {own.high:.2f}]",
                    "gamma = 1: error / bound": f"{told['farsighted'].mean:.1f}",
                    "90 % intervals that hold gamma": f"{np.mean(covered):.0%}",
                    "broke": sum(bool(r["error"]) for r in mine),
                }
            )
    return lines


def run(setting: Setting) -> list[Result]:
    """The study; `quick` has 2 noisy levels of 4 sequences, else 5 of 50."""
    levels, sequences = (3, 4) if setting.quick else (6, 50)
    with tempfile.TemporaryDirectory() as folder:
        rows = estimation.study(Path(folder) / "estimation", levels, sequences)
    equivalence: Row = {
        "quantity": "error of the best gamma = 1 fit, reference cost",
        "here": f"{reference_error():.4f}",
        "reference": str(REFERENCE_ERROR),
    }
    results = [
        Result(
            "Noise-free recovery",
            f"Error ||X - X_true||^2 of estimates that start at random discount factors. The "
            f"prior on gamma counts as with a noise of {LEAST_STD:g} m.",
            noise_free(rows),
        ),
        Result(
            "Accuracy against the Cramer-Rao bound",
            f"Mean of ||X - X_true||^2 over {sequences} sequences, divided by the bound for 14 "
            "parameters; 95 % intervals of the mean. 1 is what an efficient estimator reaches.",
            against_bound(rows),
        ),
        Result(
            "Equivalence with the reference implementation",
            "Initial state fixed at the truth, no noise, full state, goals fitted.",
            [equivalence],
        ),
    ]
    return [result.show(setting.console) for result in results]
