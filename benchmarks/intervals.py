"""How often 90 % intervals of discount factors hold the truth: Laplace, profile and posterior."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick
from evaluation.metrics.trajectory import trajectory_error
from evaluation.studies.estimation import (
    OBSERVATIONS,
    estimated,
    fit,
    gamma_covered,
    joint,
    truth,
)
from foresight_env.equilibrium import Status
from foresight_env.inverse import Estimate, Posterior, Profile
from foresight_env.scenarios.crosswalk import MONTE_CARLO

STDS = (0.005, 0.01, 0.02, 0.04, 0.08)
"""Of the noise, m."""
VARIANTS: dict[str, tuple[Profile | None, Posterior | None]] = {
    "Laplace": (None, None),
    "profile": (Profile(), None),
    "posterior": (None, Posterior()),
}
"""Settings of `estimate`; the last one estimates the posterior's mean instead of the best fit."""


def gamma_identified(found: Estimate) -> np.ndarray:
    """Which discount factors are not flagged as open."""
    return found.gamma_identifiable


def row(
    observation: str, std: float, variant: str, sequences: int, yardstick: Yardstick
) -> TableRow:
    """One line of the table."""
    found, seconds = [], []
    for k in range(sequences):
        begin = time.perf_counter()
        profile, posterior = VARIANTS[variant]
        found.append(fit(observation, std, k, "infer-gamma", profile=profile, posterior=posterior))
        seconds.append(time.perf_counter() - begin)
    failed = sum(int(f.status) != Status.SOLVED for f in found)
    found = [f for f in found if int(f.status) == Status.SOLVED]
    covered = np.array([gamma_covered(f) for f in found])
    doubt = covered.mean(axis=1).std() / np.sqrt(len(covered))
    identified = np.array([gamma_identified(f) for f in found])
    gammas = [f.gamma if f.mean is None else f.mean.gamma for f in found]
    errors = np.array(gammas) - MONTE_CARLO.gamma
    true = joint(truth("soft"))
    widths = np.array([np.diff(f.gamma_interval)[:, 0] for f in found])
    return {
        "observed": observation,
        "noise std [m]": std,
        "intervals": variant,
        "failed": failed,
        "hold the truth": f"{covered.mean():.0%} ± {doubt:.0%}",
        "gamma open": f"{1.0 - identified.mean():.0%}",
        "hold it, not open": f"{covered[identified].mean():.0%}" if identified.any() else "-",
        "width, median": float(np.median(widths)),
        "error of gamma, rms": float(np.sqrt(np.mean(errors**2))),
        "error of the trajectory, mean": float(
            np.mean([trajectory_error(estimated(f), true) for f in found])
        ),
        "objective, mean": float(np.mean([f.cost for f in found])),
        "forward solves, mean": int(np.mean([f.num_forward_solves for f in found])),
        "time, median": yardstick.formatted(float(np.median(seconds))),
    }


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has one level of 4 sequences."""
    sequences, stds = (4, STDS[1:2]) if arguments.quick else (40, STDS)
    yardstick = Yardstick.measure()
    rows: list[TableRow] = []
    for observation in OBSERVATIONS:
        for profile, posterior in VARIANTS.values():  # compiles
            fit(observation, STDS[0], 0, "infer-gamma", profile=profile, posterior=posterior)
        for std in stds:
            for name in VARIANTS:
                with arguments.console.status(f"{observation}, {std:g} m, {name}"):
                    rows.append(row(observation, std, name, sequences, yardstick))
    note = (
        f"Crosswalk, T = 25, 14 unknowns, {sequences} sequences of the Monte Carlo study per line, "
        "both players' discount factors (true values 0.95 and 0.9). 90 % intervals, with "
        "the standard error of their share over sequences. Objective: what fits minimise; the "
        "profile replaces a fit by a better one that it meets. Posterior: its means instead of the "
        f"best fit's values. {yardstick.note}"
    )
    return [Result("Intervals of discount factors", note, rows).show(arguments.console)]
