"""Commands that run episodes, studies and estimates, and print and draw what they find."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.execution.local import Workers
from evaluation.reports.driving import distances_over_time, print_driving
from evaluation.reports.episode_pictures import draw_episode
from evaluation.reports.figures import (
    HEATMAP_NAME,
    TRIAL_NAME,
    closed_loop_summary,
    error_against_noise,
    objective_heatmap,
    recorded_encounter,
    representative_trial,
)
from evaluation.reports.intersection import (
    SNAPSHOT,
    error_over_noise,
    print_compared_gammas,
    print_comparison,
    print_errors,
    print_gammas,
    print_violations,
    snapshot,
)
from evaluation.reports.naming import file_name, label_of
from evaluation.reports.prediction import (
    curves,
    draw_reliability,
    error_over_time,
    print_prediction,
)
from evaluation.reports.tables import (
    print_closed_loop,
    print_encounters,
    print_estimation,
    told_gamma,
)
from evaluation.reports.terminal import terminal
from evaluation.rollout.endings import ending
from evaluation.rollout.episode import episode, inferred
from evaluation.rollout.setting import RunSetting
from evaluation.samples import junction as junction_sample
from evaluation.samples.junction import write_junction_sample
from evaluation.samples.recording import write_sample
from evaluation.studies import closed_loop, estimation, prediction
from evaluation.studies import driving as driving_study
from evaluation.studies import intersection as intersection_study
from evaluation.studies.closed_loop import ClosedLoop, summarise
from evaluation.studies.driving import DrivingConfiguration
from evaluation.studies.heatmap import heatmap
from evaluation.studies.intersection import least_observed, observed_steps
from evaluation.studies.junction_comparison import compare
from evaluation.windows.encounters import PREDICTORS, encounters, forecast
from evaluation.windows.intersection import Choice, contradictions, load
from foresight_env.datasets import Recording
from foresight_env.inverse import Profile

TRIAL_STD = 0.05
"""Noise of the representative trial, m and m/s."""


def run_one(ego: str, seed: int, setting: RunSetting, human: bool, out: Path) -> None:
    """`foresight run`."""
    console = terminal()
    if human:
        env = setting.make("human")
        from evaluation.reports.episode_pictures import overlay_of

        for step in episode(env, setting, ego, seed):
            env.set_overlay(overlay_of(step, ego, setting))
        env.close()
    draw_run(console, ego, seed, setting, out)


def draw_run(console: Console, ego: str, seed: int, setting: RunSetting, out: Path) -> None:
    """Run one episode, print its result and draw it in the folder `out`."""
    with console.status(f"running ego {label_of(ego)} (the first steps compile)"):
        shown = draw_episode(ego, seed, setting, out)
    last = shown.steps[-1]
    where = setting.scene if setting.scenario == "driving" else setting.scenario
    table = Table(title=f"{where.replace('_', ' ')}, seed {seed}: ego {label_of(ego)}")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    table.add_row("end", f"{ending(last.info)} after {last.info['time']:.1f} s")
    table.add_row("smallest gap to others", f"{last.info['min_distance']:.2f} m")
    for j, (mean, deviation) in last.decision.gammas.items():
        gamma = setting.true_gammas(last.info)[j]
        true = "none (plays no game)" if np.isnan(gamma) else f"{gamma:.2f}"
        if inferred(ego, last.decision):
            told = f"{told_gamma(mean, deviation)}, {true}"
            table.add_row(f"gamma of agent {j}: inferred (±90 %), true", told)
        else:
            table.add_row(f"gamma of agent {j}: true", true)
    for name in dict.fromkeys(h.name for s in shown.steps for h in s.decision.hypotheses):
        weights = [h.weight for s in shown.steps for h in s.decision.hypotheses if h.name == name]
        told = f"{min(weights):.0%} to {max(weights):.0%}, last {weights[-1]:.0%}"
        table.add_row(f"weight of hypothesis {name}", told)
    milliseconds = 1e3 * np.array([s.latency for s in shown.steps[2:]])
    if milliseconds.size:
        table.add_row("decision, median", f"{np.median(milliseconds):.0f} ms")
    table.add_row(
        "actions that the safety filter replaced",
        str(sum(s.decision.intervention for s in shown.steps)) if setting.safety_filter else "off",
    )
    table.add_row(
        "failed plans, failed fits",
        f"{sum(s.decision.plan_fallback for s in shown.steps)}, "
        f"{sum(s.decision.estimate_outdated for s in shown.steps)}",
    )
    console.print(table)
    for path in (shown.animation, shown.still, shown.curve):
        if path is not None:
            print_picture(console, path)


def print_picture(console: Console, picture: Path) -> None:
    """Print where a picture is, in one line."""
    console.print(f"picture: {picture}", soft_wrap=True, markup=False)


def evaluate_crosswalk(
    episodes: int,
    levels: int,
    sequences: int,
    grid: int,
    egos: tuple[str, ...],
    players: int,
    observation: str,
    noise_std: float,
    safety_filter: bool,
    workers: Workers,
    out: Path,
) -> None:
    """`foresight evaluate crosswalk`."""
    if not (episodes or levels or grid):
        raise ValueError("--episodes, --levels, --grid: are all 0; there is nothing to evaluate")
    console = terminal()
    pictures: list[Path] = []
    if episodes:
        setting = ClosedLoop(players, observation, noise_std, safety_filter=safety_filter)
        rows = closed_loop.study(
            out / "closed_loop", egos, range(episodes), setting, workers=workers
        )
        print_closed_loop(console, [summarise(rows, e) for e in egos], rows)
        pictures.append(closed_loop_summary(rows, egos, out / "closed_loop.png"))
    if levels:
        rows = estimation.study(out / "estimation", levels, sequences, workers=workers)
        print_estimation(console, rows)
        pictures.append(error_against_noise(rows, out / "error_against_noise.png"))
        pictures.append(draw_trial(console, out))
    if grid:
        with console.status("heatmap of the objective"):
            values = heatmap(grid)
        if values.unsolved:
            console.print(f"heatmap: {values.unsolved} of {grid**2} games not solved, left blank")
        objective_heatmap(values, out / f"{HEATMAP_NAME}.pdf")
        pictures.append(objective_heatmap(values, out / f"{HEATMAP_NAME}.png"))
    for path in pictures:
        print_picture(console, path)


def evaluate_driving(
    episodes: int,
    scenes: tuple[str, ...],
    others: tuple[str, ...],
    egos: tuple[str, ...],
    setting: DrivingConfiguration,
    workers: Workers,
    out: Path,
) -> None:
    """`foresight evaluate driving`."""
    console = terminal()
    rows = driving_study.study(
        out / "episodes", scenes, others, egos, range(episodes), setting, workers=workers
    )
    print_driving(console, rows, scenes, others, egos)
    for scene in scenes:
        for other in others:
            path = out / f"{scene}_{other}.png"
            print_picture(console, distances_over_time(rows, scene, other, egos, path))


def draw_trial(console: Console, out: Path) -> Path:
    """Fit one noisy crossing by every method; return the picture, in the folder `out`."""
    with console.status("representative trial"):
        seen, _ = estimation.observe("full", TRIAL_STD, 0, "soft")
        fits = {
            m: estimation.fit("full", TRIAL_STD, 0, m, profile=Profile())
            for m in estimation.METHODS
        }
        representative_trial(seen, fits, out / f"{TRIAL_NAME}.pdf")
        return representative_trial(seen, fits, out / f"{TRIAL_NAME}.png")


def evaluate_intersection(
    choice: Choice | None,
    levels: int,
    sequences: int,
    parameters: str,
    at: int | None,
    workers: Workers,
    out: Path,
) -> None:
    """`foresight evaluate intersection`; without a choice, on a recording of the project's own."""
    console = terminal()
    if choice is None:
        first, last = junction_sample.FRAMES
        observed_steps(at, (last - first) // junction_sample.EVERY + 1)
        made = write_junction_sample(out / "recorded")
        console.print(
            "No --data given: this recording was made by the project itself, in inD's format, from "
            f"a game with known discount factors: {', '.join(map(str, junction_sample.GAMMAS))}."
        )
        console.print(f"recording: {made}", soft_wrap=True, markup=False)
        choice = Choice(
            str(made),
            junction_sample.TRACKS,
            junction_sample.FRAMES,
            junction_sample.EVERY,
            str(junction_sample.NUMBER),
        )
    case = load(choice)
    known = observed_steps(at, len(case.states), least_observed(case))  # now, not after the study
    where = "the published junction" if case.at_aachen else "open ground"
    agents, steps = ", ".join(case.agents), len(case.states)
    console.print(f"{case.name}: {agents}; {steps} steps of {case.dt:.2f} s; {where}", markup=False)
    print_violations(console, contradictions(case, len(case.states)))
    rows = intersection_study.study(
        out / "study", choice, levels, sequences, parameters=parameters, workers=workers
    )
    print_errors(console, rows)
    print_gammas(console, rows)
    with console.status("comparing the published and the realistic game"):
        compared = compare(case, known, parameters)
    print_comparison(console, case, known, compared)
    print_compared_gammas(console, case, compared)
    print_picture(console, error_over_noise(rows, out / "error_against_noise.png"))
    snapshot(case, known, compared, out / f"{SNAPSHOT}.pdf")
    print_picture(console, snapshot(case, known, compared, out / f"{SNAPSHOT}.png"))


def evaluate_prediction(
    data: Path | None,
    predictors: Sequence[str],
    split: str,
    windows: str,
    recordings: bool,
    workers: Workers,
    out: Path,
) -> None:
    """`foresight evaluate prediction`; without data, on a recording of the project's own."""
    console = terminal()
    if data is None:
        data = write_sample(out / "recorded").parent
        console.print(
            "No --data given: this recording was made by the project itself, in the DUT format."
        )
    rows = prediction.study(
        out / "study", data, predictors, split=split, windows=windows, workers=workers
    )
    print_prediction(console, rows, recordings=recordings)
    print_picture(console, error_over_time(rows, out / "error_over_time.png"))
    if curves(rows):
        print_picture(console, draw_reliability(rows, out / "reliability.png"))


def estimate_recorded(
    recording: Recording,
    agents: tuple[str, ...] | None,
    count: int | None,
    pictures: bool,
    out: Path,
) -> None:
    """`foresight estimate`."""
    console = terminal()
    # Everything that can be wrong with the input is found before anything is written.
    chosen = encounters(recording, agents=agents, count=count)
    if pictures:
        out.mkdir(parents=True, exist_ok=True)  # an unwritable folder is reported before the work
    results = []
    with console.status("inferring (the first fit compiles)"):
        for encounter in chosen:
            results.append((encounter, [forecast(encounter, p) for p in PREDICTORS]))
    print_encounters(console, results)
    if not pictures:
        return
    for encounter, forecasts in results:
        window = encounter.window
        path = out / f"{file_name(window.recording, window.agents)}.png"
        print_picture(console, recorded_encounter(encounter, forecasts, path))
