"""`foresight evaluate`: methods over many trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from evaluation.cli.options import (
    ALL_EGO_NAMES,
    CROSSWALK_EGO_NAMES,
    DRIVING_EGO_NAMES,
    EGO_HELP,
    EGO_NAMES,
    PREDICTOR_NAMES,
    ClusterOption,
    ColumnsOption,
    NoiseOption,
    OutOption,
    PlayersOption,
    RateOption,
    SafetyFilterOption,
    SeedsOption,
    Split,
    WorkersOption,
    check_noise,
    chosen_agents,
    chosen_seeds,
    chosen_workers,
    listed,
    plain_errors,
    table_columns,
)
from foresight_env.names import DRIVING_BEHAVIOURS, SCENE_NAMES, Observation

evaluate = typer.Typer(no_args_is_help=True, help="Compare methods over many trials; figures.")


@evaluate.command("crosswalk")
@plain_errors
def evaluate_crosswalk(
    episodes: Annotated[
        int, typer.Option(min=0, help="Seeds of the closed-loop study; 0 leaves it out.")
    ] = 20,
    levels: Annotated[
        int, typer.Option(min=0, help="Noise levels of the estimation study; 0 leaves it out.")
    ] = 6,
    sequences: Annotated[int, typer.Option(min=1, help="Noisy sequences per level.")] = 10,
    grid: Annotated[
        int, typer.Option(min=0, help="Heatmap points per axis; 0 leaves it out.")
    ] = 41,
    egos: Annotated[
        str,
        typer.Option(
            help=f"Egos of the closed-loop study, comma-separated; also cloned, ppo. {EGO_HELP}"
        ),
    ] = ",".join(EGO_NAMES),
    players: PlayersOption = 2,
    observation: Annotated[
        Observation, typer.Option(help="What the egos see in the closed loop.")
    ] = "full",
    noise_std: NoiseOption = 0.05,
    safety_filter: SafetyFilterOption = True,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/evaluate"),
) -> None:
    """Compare egos in the closed loop, and estimation errors over noise; tables and figures.

    Interrupted studies are resumed. The paper's size is --levels 50 --sequences 50.
    """
    names = chosen_agents("--egos", egos, CROSSWALK_EGO_NAMES)
    check_noise(noise_std)
    if grid == 1:
        raise ValueError("--grid: is 1; a heatmap has at least 2 points per axis")
    from evaluation.cli import demonstration

    demonstration.evaluate_crosswalk(
        episodes,
        levels,
        sequences,
        grid,
        names,
        players,
        observation,
        noise_std,
        safety_filter,
        chosen_workers(workers, cluster),
        out,
    )


@evaluate.command("driving")
@plain_errors
def evaluate_driving(
    episodes: Annotated[int, typer.Option(min=1, help="Noise seeds; the paper has 50.")] = 10,
    scenes: Annotated[
        str, typer.Option(help=f"Comma-separated, of {', '.join(SCENE_NAMES)}.")
    ] = SCENE_NAMES[0],
    others: Annotated[
        str,
        typer.Option(
            help=f"What the other cars do, comma-separated, of {', '.join(DRIVING_BEHAVIOURS)}."
        ),
    ] = "receding,idm",
    egos: Annotated[
        str, typer.Option(help=f"Comma-separated, of {', '.join(DRIVING_EGO_NAMES)}.")
    ] = ",".join(DRIVING_EGO_NAMES),
    cars: Annotated[int, typer.Option(min=2, max=6, help="Number of cars.")] = 4,
    observation: Annotated[Observation, typer.Option(help="What the egos see.")] = "full",
    noise_std: NoiseOption = 0.1,
    safety_filter: SafetyFilterOption = True,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/driving"),
) -> None:
    """Egos that turn, merge, change lanes and go round among other cars; tables and figures.

    Interrupted studies are resumed; more --episodes, --scenes or --egos are added to
    what is there. Ten seeds of one scene take one to three minutes on two cores.
    """
    check_noise(noise_std)
    chosen = (
        listed("--scenes", scenes, SCENE_NAMES),
        listed("--others", others, DRIVING_BEHAVIOURS),
        chosen_agents("--egos", egos, DRIVING_EGO_NAMES),
    )
    from evaluation.cli import demonstration
    from evaluation.studies.driving import DrivingConfiguration

    setting = DrivingConfiguration(cars, noise_std, observation, safety_filter)
    demonstration.evaluate_driving(
        episodes, *chosen, setting, chosen_workers(workers, cluster), out
    )


SAFETY_SETTINGS = (
    "crowd-2", "crowd-4", "crowd-6", "left_turn", "merge", "lane_change", "roundabout",
)  # fmt: skip


@evaluate.command("safety")
@plain_errors
def evaluate_safety(
    episodes: Annotated[int, typer.Option(min=1, help="Seeds per setting.")] = 20,
    seeds: SeedsOption = "test",
    settings: Annotated[
        str,
        typer.Option(
            help="Comma-separated; `foresight value --list` prints them. And recorded: the ego "
            "walks among agents of a recording, who ignore it."
        ),
    ] = ",".join(SAFETY_SETTINGS),
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder or file of recordings (inD, DUT, UCY) for the setting recorded; without "
            "it, a recording that the project makes itself."
        ),
    ] = None,
    surprises: Annotated[
        str,
        typer.Option(
            help="What the egos do not expect, comma-separated, or all: none; gamma-change (in "
            "mid-episode); ignores-others (one agent does); social-force, idm (others that play no "
            "game); dropouts, outliers (of the sensor). Where it cannot occur it is left out."
        ),
    ] = "none,idm",
    egos: Annotated[
        str, typer.Option(help=f"Comma-separated, of {', '.join(EGO_NAMES)}.")
    ] = ",".join(EGO_NAMES),
    safety_filter: SafetyFilterOption = True,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/safety"),
) -> None:
    """Collisions, at fault or not, goals, cost and interventions of the safety filter; tables.

    Interrupted studies are resumed. One seed of all default settings and egos takes one to two
    minutes on one core.
    """
    from evaluation.reports.safety import print_safety
    from evaluation.reports.terminal import terminal
    from evaluation.rollout.places import SETTINGS
    from evaluation.rollout.surprises import SURPRISES
    from evaluation.studies.safety import RECORDED, study

    chosen = listed("--settings", settings, (*SETTINGS, RECORDED))
    if data is not None and RECORDED not in chosen:
        raise ValueError(f"--data: needs {RECORDED} among --settings")
    met = (
        tuple(SURPRISES)
        if surprises == "all"
        else listed("--surprises", surprises, tuple(SURPRISES))
    )
    names = chosen_agents("--egos", egos, ALL_EGO_NAMES)
    rows = study(
        out / "episodes",
        chosen,
        met,
        names,
        chosen_seeds(seeds, episodes),
        safety_filter=safety_filter,
        data=data,
        workers=chosen_workers(workers, cluster),
    )
    print_safety(terminal(), rows, chosen, met, names)


Site = Literal["auto", "aachen", "open"]
"""Place of a recording, as far as it is known."""
EstimatedParameters = Literal["goals", "all"]
"""Parameters that are estimated in addition to discount factors."""


def _frames(text: str) -> tuple[int, int]:
    parts = text.split(":")
    if len(parts) != 2 or not all(part.strip().isdecimal() for part in parts):
        raise ValueError(f"--frames: is {text!r}; expected FIRST:LAST, such as 26158:26320")
    return int(parts[0]), int(parts[1])


@evaluate.command("intersection")
@plain_errors
def evaluate_intersection(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder or file of recordings (inD, DUT, UCY), or a CSV file with --columns and "
            "--rate; without it, a recording that the project makes itself."
        ),
    ] = None,
    recording: Annotated[
        str | None, typer.Option(help="Which recording of a folder, such as 07 or intersection_15.")
    ] = None,
    tracks: Annotated[
        str | None, typer.Option(help="Agents, such as 201,205,207,208 or veh:0,ped:6.")
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(help="FIRST:LAST, both included; default: while all of them are there."),
    ] = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    every: Annotated[int, typer.Option(min=1, help="Take every n-th frame.")] = 6,
    place: Annotated[
        Site,
        typer.Option(
            help="aachen: the published corners, sides and lanes; open: none; auto: the first for "
            "inD tracks that lie there."
        ),
    ] = "auto",
    parameters: Annotated[
        EstimatedParameters,
        typer.Option(
            help="Estimated in addition to gamma: goals, or weights and distances as well."
        ),
    ] = "goals",
    levels: Annotated[int, typer.Option(min=1, help="Noise levels, std 0 to 0.1.")] = 6,
    sequences: Annotated[int, typer.Option(min=1, help="Noisy sequences per level.")] = 10,
    at: Annotated[
        int | None,
        typer.Option(
            help="Observed steps that the predictions begin after; default: half of the window, "
            "at most 15.",
            show_default=False,
        ),
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/intersection"),
) -> None:
    """Recorded people and cars: estimation error over noise, and a prediction (paper, VI-B)."""
    if data is None and (recording or tracks or frames or columns or rate):
        raise ValueError("--recording, --tracks, --frames, --columns, --rate: need --data")
    if data is not None and tracks is None:
        raise ValueError("--tracks: is missing; name the agents, such as 201,205,207,208")
    from evaluation.cli import demonstration
    from evaluation.windows.intersection import Choice

    choice = None
    if data is not None:
        names = tuple(name.strip() for name in (tracks or "").split(","))
        span = None if frames is None else _frames(frames)
        named = table_columns(columns)
        choice = Choice(
            str(data),
            names,
            span,
            every,
            recording,
            place,
            columns=None if named is None else tuple(named.items()),
            rate=rate,
        )
    demonstration.evaluate_intersection(
        choice, levels, sequences, parameters, at, chosen_workers(workers, cluster), out
    )


Windows = Literal["interacting", "all"]
"""Which windows of recordings are predicted."""


@evaluate.command("prediction")
@plain_errors
def evaluate_prediction(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of recordings (inD, DUT, UCY), searched with all below it, or a file; "
            "without it, a recording that the project makes itself."
        ),
    ] = None,
    predictors: Annotated[
        str,
        typer.Option(
            help=f"Comma-separated, of {', '.join(PREDICTOR_NAMES)}; your own as module:Class."
        ),
    ] = ",".join(PREDICTOR_NAMES),
    split: Annotated[
        Split,
        typer.Option(
            help="development: the recordings that settings were chosen on; test: all others."
        ),
    ] = "all",
    windows: Annotated[
        Windows,
        typer.Option(
            help="interacting: agents whose paths cross soon; all: every moving agent, in groups "
            "of those near each other."
        ),
    ] = "interacting",
    by_recording: Annotated[
        bool,
        typer.Option("--by-recording", help="Also a table of each recording, such as DUT's clips."),
    ] = False,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/prediction"),
) -> None:
    """Predict recorded agents who interact: errors over 1 to 4 s, misses, overlaps, latency."""
    names = chosen_agents("--predictors", predictors, PREDICTOR_NAMES)
    from evaluation.cli import demonstration

    demonstration.evaluate_prediction(
        data, names, split, windows, by_recording, chosen_workers(workers, cluster), out
    )
