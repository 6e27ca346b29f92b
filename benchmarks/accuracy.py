"""Accuracy of the estimator: noise-free recovery, the Cramer-Rao bound, the reference's number."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import ROOT
from evaluation.execution.store import Row as Trial
from evaluation.metrics.trajectory import trajectory_error
from evaluation.reports.figures import save
from evaluation.reports.naming import colour_of, label_of
from evaluation.studies import estimation
from evaluation.studies.estimation import (
    LEAST_STD,
    OBSERVATIONS,
    bound,
    joint,
    observation_model,
    truth,
)
from foresight_env.inverse import Free, MultiStart, Prior, estimate
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

RECOVERED = 1e-6
"""Trajectory error below which a noise-free estimate counts as exact."""
REFERENCE_ERROR = 0.765
"""Error of the reference implementation's best gamma = 1 fit, from its own description."""
WANTED = 1.2
"""Mean error over the bound that every level is to stay below."""
BANDS = 5
"""Groups of neighbouring noise levels, one line each."""
PICTURE = ROOT / "docs" / "images" / "errors_beside_the_reference.png"


def reference_error() -> float:
    """The same quantity here: reference cost, x_1 known, no noise, gamma = 1, goals fitted."""
    game, setting = crosswalk_game(2, proximity="reference"), MONTE_CARLO
    true = joint(truth("reference"))
    found = estimate(
        game,
        true,
        observation_model("full"),
        initial_state=setting.initial_state,
        theta=setting.theta,
        gamma=1.0,
        free=Free(("goal",), False, False),
        covariance=1.0,
        prior=Prior(gamma_weight=0.0),
        starts=MultiStart(1),
    )
    return trajectory_error(joint(found.solution), true)


def noise_free(rows: list[Trial]) -> list[TableRow]:
    """Share of exact recoveries from random discount factors."""
    lines: list[TableRow] = []
    for observation in OBSERVATIONS:
        errors = np.array(
            [
                r["error_squared"] if not r["error"] else np.inf
                for r in rows
                if (r["observation"], r["std"], r["method"]) == (observation, 0.0, "infer-gamma")
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


def by_band(rows: list[Trial]) -> list[TableRow]:
    """Per band of noise levels: errors over the Cramer-Rao bound, and how often intervals hold."""
    lines: list[TableRow] = []
    levels = sorted({r["std"] for r in rows if r["std"] > LEAST_STD})
    for observation in OBSERVATIONS:
        for band in np.array_split(np.array(levels), min(BANDS, len(levels))):
            mine = [r for r in rows if r["observation"] == observation and r["std"] in band]
            good = [r for r in mine if not r["error"]]
            ratios = {
                method: np.array(
                    [
                        mean_error(rows, observation, method, std) / (bound(observation) * std**2)
                        for std in band
                    ]
                )
                for method in estimation.METHODS
            }
            pairs = [
                pair
                for r in good
                if r["method"] == "infer-gamma"
                for pair in zip(r["gamma_covered"], r["gamma_identifiable"], strict=True)
            ]
            covered_ones = [covered for covered, identifiable in pairs if identifiable]
            own = ratios["infer-gamma"]
            lines.append(
                {
                    "observed": observation,
                    "noise std [m]": f"{band[0]:.3f} to {band[-1]:.3f}",
                    "levels": len(band),
                    "error / bound, mean": float(own.mean()),
                    "worst level": float(own.max()),
                    f"levels below {WANTED:g}": int(np.sum(own <= WANTED)),
                    "assume-gamma-1: error / bound": float(ratios["assume-gamma-1"].mean()),
                    "90 % intervals that hold gamma": f"{np.mean(covered_ones):.0%}"
                    if covered_ones
                    else "-",
                    "gamma open": f"{1.0 - len(covered_ones) / len(pairs):.0%}",
                    "seconds, median": float(np.median([r["seconds"] for r in good])),
                    "failed": len(mine) - len(good),
                }
            )
    return lines


def mean_error(rows: list[Trial], observation: str, method: str, std: float) -> float:
    """Mean of `||X - X_true||^2` over the sequences of one noise level that did not break."""
    wanted = (observation, method, std)
    mine = [r for r in rows if (r["observation"], r["method"], r["std"]) == wanted]
    return float(np.mean([r["error_squared"] for r in mine if not r["error"]]))


def published(folder: Path) -> dict[tuple[str, str], PublishedErrors]:
    """The reference implementation's errors: a row per level, a letter and its std, then errors."""
    found = {}
    for observation, short in (("full", "fo"), ("positions", "po")):
        for method, name in (("infer-gamma", "ours"), ("assume-gamma-1", "baseline")):
            lines = (folder / f"crosswalk_{short}_{name}.txt").read_text().splitlines()
            table = [line.split() for line in lines if line.strip()]
            stds = np.array([float(row[0].lstrip("mb")) for row in table])
            errors = [np.array(row[1:], float) for row in table]
            # An error of exactly 0 under noise is no estimate.
            means = [e[e > 0.0].mean() if (e > 0.0).any() else 0.0 for e in errors]
            found[observation, method] = PublishedErrors(stds, np.array(means))
    return found


class PublishedErrors(NamedTuple):
    """Mean errors over noise."""

    stds: np.ndarray
    errors: np.ndarray


def picture(rows: list[Trial], theirs: dict[tuple[str, str], PublishedErrors]) -> None:
    """Our mean errors, the reference's and the bound."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    for axes, observation in zip(figure.subplots(1, 2, sharey=True), OBSERVATIONS, strict=True):
        stds = sorted({r["std"] for r in rows if r["std"] > LEAST_STD})
        for method in estimation.METHODS:
            colour, label = colour_of(method), label_of(method)
            means = [mean_error(rows, observation, method, s) for s in stds]
            axes.plot(stds, means, color=colour, label=label)
            other = theirs[observation, method]
            noisy = other.stds > 0.0
            axes.plot(
                other.stds[noisy], other.errors[noisy], ":", color=colour,
                label=f"{label}, reference",
            )  # fmt: skip
        limit = bound(observation) * np.array(stds) ** 2
        axes.plot(stds, limit, "k--", lw=1.2, label="Cramer-Rao bound")
        axes.set_yscale("log")
        axes.set_xlabel("noise standard deviation [m, m/s]")
        axes.set_title("full state" if observation == "full" else "positions only")
    figure.axes[0].set_ylabel("mean of ||X - X_true||^2")
    figure.axes[0].legend(fontsize=8)
    figure.suptitle(
        "The reference starts its descent at the true parameters, we at random ones", fontsize=9
    )
    save(figure, PICTURE)


def run(arguments: Arguments) -> list[Result]:
    """The study at the paper's size; `quick` has 2 noisy levels of 4 sequences."""
    levels, sequences = (3, 4) if arguments.quick else (50, 50)
    theirs = None if arguments.reference is None else published(arguments.reference)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        rows = estimation.study(Path(folder) / "estimation", levels, sequences)
        minutes = (time.perf_counter() - begin) / 60.0
    drawn = ""
    if theirs is not None and not arguments.quick:
        picture(rows, theirs)
        drawn = f" ![errors and the reference's](../images/{PICTURE.name})"
    equivalence: TableRow = {
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
            f"Mean of ||X - X_true||^2 over {sequences} sequences per level, divided by the bound "
            "for 14 parameters: 1 is what an efficient estimator reaches. The bound is local and "
            "knows nothing of limits on velocities and discount factors. Intervals: of discount "
            f"factors that are not flagged as open. {len(rows)} estimates with all compilation: "
            f"{minutes:.1f} minutes.{drawn}",
            by_band(rows),
        ),
        Result(
            "Equivalence with the reference implementation",
            "Initial state fixed at the truth, no noise, full state, goals fitted.",
            [equivalence],
        ),
    ]
    return [result.show(arguments.console) for result in results]
