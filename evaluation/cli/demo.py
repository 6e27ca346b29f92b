"""`foresight demo`: four parts and a summary of what they showed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from evaluation.cli.demonstration import (
    draw_run,
    draw_trial,
    estimate_recorded,
    print_picture,
)
from evaluation.execution.local import Workers
from evaluation.execution.store import Row
from evaluation.reports.figures import error_against_noise
from evaluation.reports.naming import file_name, label_of
from evaluation.reports.partial_encounter import (
    partial_encounter_picture,
    print_partial_encounters,
)
from evaluation.reports.tables import print_estimation
from evaluation.reports.terminal import terminal
from evaluation.reports.value import print_value, value_figure
from evaluation.rollout.endings import harmed
from evaluation.rollout.places import SETTINGS
from evaluation.samples import recording as sample
from evaluation.studies import estimation, value
from evaluation.studies.value_summary import episodes_of
from evaluation.windows.encounters import encounters
from evaluation.windows.partial_encounter import PartialEncounter, predict_encounters
from foresight_env.datasets import Recording, open_recording

SETTING = "crowd-3-short"
"""Setting in which knowing the others' discount factors is worth most (docs/measurements.md)."""
SEEDS = range(8)
EGOS = ("oracle", "infer-gamma", "assume-gamma-1", "constant-velocity")
INTRODUCTION = (
    "An ego (gamma 0.95) crosses the way of two others, whose discount factors it does not know: "
    "between 0.2 and 0.7. The oracle knows them and plays the others' own equilibrium; infer-gamma "
    "infers them from noisy observations; assume-gamma-1 takes them for 1."
)
OBSERVED_SECONDS = 2.8
"""Seconds observed of each sample encounter; by then the car has begun to swerve and the
pedestrian to brake."""


def demonstrate(data: Recording | None, workers: Workers, out: Path) -> None:
    """`foresight demo`.

    Args:
        data: a recording for the first part; None: the sample that the project makes itself.
        workers: processes of the crowd's episodes.
        out: folder for results and pictures.
    """
    console = terminal()
    if data is not None:
        encounters(data, count=2)  # that there is none is reported at once, not after two minutes
    console.rule("1. Recorded data: infer from the first seconds, predict the rest")
    summary: list[str] = []
    if data is None:
        summary.append(_recorded(console, out / "recorded"))
    else:
        estimate_recorded(data, None, 2, True, out / "recorded")
    console.rule("2. The value of knowing the others' foresight: four egos, the same crossings")
    summary.append(_compared(console, workers, out))
    console.rule("3. One of them: the ego infers the others' foresight while it walks")
    draw_run(console, "infer-gamma", SEEDS[0], SETTINGS[SETTING], out / "episode")
    console.rule("4. How well can foresight be inferred? Error against noise")
    summary.append(_accuracy(console, out))
    console.rule("Summary")
    for sentence in summary:
        console.print(sentence, highlight=False)


def _recorded(console: Console, out: Path) -> str:
    console.print(
        "No --data given: this recording was made by the project itself, in the DUT format, from "
        "a game with known discount factors. Twice a person meets a car."
    )
    made = sample.write_sample(out)
    console.print(f"recording: {made}", soft_wrap=True, markup=False)
    recording, true = open_recording(made), sample.true_gammas()
    with console.status("inferring (the first fit compiles)"):
        found = [
            predict_encounters(
                recording, OBSERVED_SECONDS, agents=pair, collision_weight=sample.COLLISION_WEIGHT
            )[0]
            for pair in sample.driven_pairs()
        ]
    print_partial_encounters(console, found, true)
    for encounter in found:
        path = out / f"{file_name(encounter.recording, encounter.agents)}.png"
        print_picture(console, partial_encounter_picture(encounter, path))
    return recorded_sentence(found, true)


def recorded_sentence(found: Sequence[PartialEncounter], true: Mapping[str, float]) -> str:
    """Return the summary's sentence about predicted encounters; `true`: gammas by agent."""
    inside = [
        low <= true[agent] <= high
        for encounter in found
        for agent, (low, high) in zip(
            encounter.agents, encounter.estimate.gamma_interval, strict=True
        )
    ]
    errors = {
        name: float(np.mean([e.average_errors[name] for e in found])) for name in found[0].predicted
    }
    return (
        f"Recorded data: {sum(inside)} of {len(inside)} discount factors lie in their 90 % "
        "intervals, and predictions of the rest are off by "
        + _listed({name: f"{error:.2f} m" for name, error in errors.items()})
        + "."
    )


def _listed(told: dict[str, str]) -> str:
    parts = [f"{text} ({label_of(name)})" for name, text in told.items()]
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _compared(console: Console, workers: Workers, out: Path) -> str:
    console.print(INTRODUCTION)
    # What an earlier version left there would hide the results of this one.
    filtered, free = (
        value.study(
            out / folder, (SETTING,), EGOS, SEEDS, workers=workers, clairvoyant=False,
            safety_filter=folder == "value", fresh=True,
        )
        for folder in ("value", "value_without_filter")
    )  # fmt: skip
    print_value(console, filtered, (SETTING,), EGOS, "oracle")
    collisions = {ego: str(_num_harmed(free, ego)) for ego in EGOS}
    console.print(
        f"Without the safety filter, collisions in {len(SEEDS)} episodes: {_listed(collisions)}.",
        highlight=False,
    )
    print_picture(console, value_figure(filtered, (SETTING,), EGOS, out / "value.png"))
    return crowd_sentence(filtered, free)


def crowd_sentence(filtered: Sequence[Row], free: Sequence[Row]) -> str:
    """Return the summary's sentence about the crowd.

    Args:
        filtered: episodes of `EGOS` behind the safety filter.
        free: the same without it.
    """
    costs = {
        ego: f"{np.mean([row['cost'] for row in episodes_of(filtered, SETTING, ego).values()]):.1f}"
        for ego in EGOS
    }
    harm = sum(_num_harmed(filtered, ego) for ego in EGOS)
    collisions = _listed({ego: str(_num_harmed(free, ego)) for ego in EGOS})
    return (
        f"Crowd: behind the safety filter ({harm} of {len(SEEDS) * len(EGOS)} episodes with a "
        f"collision) an episode costs {_listed(costs)}; without it they collide in {collisions} of "
        f"{len(SEEDS)}."
    )


def _num_harmed(rows: Sequence[Row], ego: str) -> int:
    return sum(harmed(row) for row in episodes_of(rows, SETTING, ego).values())


def _accuracy(console: Console, out: Path) -> str:
    # In this process: compiling takes longer than these few fits, and the next picture needs it.
    rows = estimation.study(out / "estimation", 3, 3, observations=("full",), workers=0, fresh=True)
    print_estimation(console, rows)
    print_picture(console, error_against_noise(rows, out / "error_against_noise.png"))
    print_picture(console, draw_trial(console, out))
    return accuracy_sentence(rows)


def accuracy_sentence(rows: Sequence[Row]) -> str:
    """Return the summary's sentence about estimates from full states, at the least noise."""
    good = [row for row in rows if not row["error"] and row["std"] > estimation.LEAST_STD]
    std = min(row["std"] for row in good)
    limit = estimation.bound("full") * std**2
    errors = {
        method: [r["error_squared"] for r in good if r["method"] == method and r["std"] == std]
        for method in estimation.METHODS
    }
    ratios = {method: f"{np.mean(found) / limit:.1f}" for method, found in errors.items() if found}
    return (
        f"Accuracy: from states with noise of {std:g} (std, m and m/s) the squared error is "
        f"{_listed(ratios)} times the Cramer-Rao bound."
    )
