"""The command `foresight`."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from agents.registry import REACTIVE_EGOS, check_extra, is_custom
from evaluation.cli.benchmark import benchmark
from evaluation.cli.evaluate import evaluate
from evaluation.cli.learn import generate, train
from evaluation.cli.options import (
    EGO_HELP,
    ColumnsOption,
    OutOption,
    RateOption,
    SafetyFilterOption,
    WorkersOption,
    check_ego,
    check_noise,
    look_here,
    make_all,
    plain_errors,
    table_columns,
)
from evaluation.cli.protocols import evaluate_eth_ucy, export
from evaluation.cli.value import value
from foresight_env.names import (
    SCENARIOS,
    SCENE_NAMES,
    DrivingBehaviour,
    Observation,
    SceneName,
)

# Typer brings a copy of Click or not, by its version; its own error derives from the right one.
UsageError: Any = typer.BadParameter.__mro__[1]

app = typer.Typer(
    help="Agents that differ in foresight: simulate them, infer it, judge who predicts best.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},  # of all subcommands, too
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> bool:
    if wanted:
        from foresight_env import __version__

        typer.echo(f"foresight_env {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Options of the command itself."""


evaluate.command("eth-ucy")(evaluate_eth_ucy)
app.add_typer(evaluate, name="evaluate")
app.command("value")(value)
app.command("benchmark")(benchmark)
app.command("generate")(generate)
app.command("train")(train)
app.command("export")(export)


@app.command()
@plain_errors
def run(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SETTING",
            help=f"A scenario ({', '.join(SCENARIOS)}) or a setting that `foresight value --list` "
            "prints, such as crowd-3-short.",
            show_default=False,
        ),
    ],
    ego: Annotated[
        str,
        typer.Option(
            callback=check_ego,
            help=f"{EGO_HELP} In driving also idm, highway-env's own vehicle; at the crosswalk "
            "also cloned and ppo, networks that decide without planning.",
        ),
    ] = "infer-gamma",
    seed: Annotated[int, typer.Option(min=0, help="Episode.")] = 0,
    scene: Annotated[
        SceneName | None,
        typer.Option(help=f"Of driving; default {SCENE_NAMES[0]}.", show_default=False),
    ] = None,
    players: Annotated[
        int | None, typer.Option(min=2, max=6, help="Number of agents or cars.")
    ] = None,
    observation: Annotated[Observation, typer.Option(help="What the ego sees.")] = "full",
    behaviour: Annotated[
        DrivingBehaviour, typer.Option(help="What the others do; idm: cars of driving.")
    ] = "receding",
    noise_std: Annotated[
        float | None,
        typer.Option(min=0.0, help="Noise std of every observed coordinate; default: as usual."),
    ] = None,
    safety_filter: SafetyFilterOption = True,
    human: Annotated[bool, typer.Option("--human", help="Show it live in a window.")] = False,
    out: OutOption = Path("results/run"),
) -> None:
    """Run one episode: table, picture, animation, inferred discount factors over time."""
    if noise_std is not None:
        check_noise(noise_std)
    if scene is not None and name != "driving":
        raise ValueError(f"--scene: is {scene}; only the scenario driving has scenes")
    if name not in SCENARIOS and players is not None:
        raise ValueError(f"--players: the setting {name} says how many; leave the option out")
    from evaluation.rollout.places import setting_of
    from evaluation.rollout.setting import RunSetting

    if name in SCENARIOS:
        setting = RunSetting(
            name,
            scene or SCENE_NAMES[0],
            players,
            observation,
            noise_std,
            behaviour,
            safety_filter=safety_filter,
        )
    else:
        chosen = setting_of(name, behaviour)
        setting = replace(
            chosen,
            observation=observation,
            noise_std=noise_std,
            safety_filter=safety_filter,
        )
    scenario = setting.scenario
    if is_custom(ego):
        make_all("--ego", [ego])
    elif ego == "idm" and scenario != "driving":
        raise ValueError(f"--ego: {ego} drives cars of the scenario driving only")
    elif ego in REACTIVE_EGOS and scenario != "crosswalk":
        raise ValueError(f"--ego: {ego} walks in the scenario crosswalk only")
    check_extra(ego)
    from evaluation.cli.demonstration import run_one

    run_one(ego, seed, setting, human, out)


@app.command()
@plain_errors
def estimate(
    file: Annotated[
        Path,
        typer.Argument(
            help="A DUT (*_ped_filtered.csv), UCY (obsmat.txt) or inD recording, or a CSV file "
            "with --columns and --rate."
        ),
    ],
    ids: Annotated[
        str | None, typer.Option(help="Two agents, such as 'veh:0,ped:6' (DUT) or '16,18' (UCY).")
    ] = None,
    count: Annotated[
        int, typer.Option(min=0, help="Without --ids: how many closest crossings; 0 for all.")
    ] = 3,
    recording: Annotated[
        str | None, typer.Option(help="Number of the recording in an inD folder, such as 07.")
    ] = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    whole: Annotated[
        bool,
        typer.Option(
            "--whole",
            help="Infer discount factors, with 90 % intervals, from the whole encounter instead "
            "of predicting its second part.",
        ),
    ] = False,
    observe: Annotated[
        float | None,
        typer.Option(
            help="Seconds to observe, from 3 s before the first agent reaches the crossing point, "
            "or from when both are there. Infers discount factors with 90 % intervals from them, "
            "predicts the rest and compares with gamma = 1 and constant velocity.",
            show_default=False,
        ),
    ] = None,
    collision_weight: Annotated[
        float | None,
        typer.Option(
            help="Of --whole and --observe: how much being close costs, which discount factors are "
            "inferred given; default 0.3, which predicts recorded people best.",
            show_default=False,
        ),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw each encounter.")] = True,
    out: OutOption = Path("results/estimate"),
) -> None:
    """Recorded data: infer on the first part of an encounter, predict the rest, compare.

    With --whole: infer from all of it. With --observe SECONDS: infer from the first seconds. Of a
    CSV file name the columns: --columns time,person,x,y.
    """
    if whole and observe is not None:
        raise ValueError("--observe: --whole observes everything; give one of the two")
    if observe is not None and not (math.isfinite(observe) and observe > 0.0):
        raise ValueError(f"--observe: is {observe}; expected a positive number of seconds")
    if collision_weight is not None and not whole and observe is None:
        raise ValueError("--collision-weight: needs --whole or --observe")
    from foresight_env.datasets import open_recording

    named = table_columns(columns)
    opened = open_recording(file, recording=recording, columns=named, rate=rate)
    agents = None if ids is None else tuple(part.strip() for part in ids.split(","))
    if whole or observe is not None:
        from evaluation.cli.whole_encounters import estimate_part, estimate_whole
        from foresight_env.scenarios.encounter import COLLISION_WEIGHT

        weight = COLLISION_WEIGHT if collision_weight is None else collision_weight
        if observe is None:
            estimate_whole(opened, agents, count or None, weight, pictures, out)
        else:
            estimate_part(opened, agents, count or None, weight, observe, pictures, out)
        return
    from evaluation.cli.demonstration import estimate_recorded

    estimate_recorded(opened, agents, count or None, pictures, out)


@app.command()
@plain_errors
def report(
    folder: Annotated[Path, typer.Argument(help="A folder of results, of one study or several.")],
    episodes: Annotated[
        int, typer.Option(min=0, help="Per study, to be run again and stepped through.")
    ] = 4,
    markdown: Annotated[
        Path | None,
        typer.Option(help="Also write these numbers and the paper's, as Markdown, to this file."),
    ] = None,
) -> None:
    """One page from a folder of results: tables, figures, failures, and episodes to step through.

    FOLDER/report.html needs no network; FOLDER/figures has every figure as PNG and PDF.
    """
    from evaluation.reports.comparison import write_comparison
    from evaluation.reports.page import write_report

    look_here()
    if markdown is not None:
        typer.echo(f"comparison: {write_comparison(folder, markdown)}")
    typer.echo(f"page: {write_report(folder, episodes)}")


@app.command()
@plain_errors
def demo(
    data: Annotated[
        Path | None,
        typer.Option(help="A recording to begin with; default: one that the project makes itself."),
    ] = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    workers: WorkersOption = None,
    out: OutOption = Path("results/demo"),
) -> None:
    """The whole idea in about two minutes: recorded data, comparison, one episode, accuracy."""
    if data is None and (columns is not None or rate is not None):
        raise ValueError("--columns, --rate: need --data")
    from foresight_env.datasets import open_recording

    named = table_columns(columns)
    opened = None if data is None else open_recording(data, columns=named, rate=rate)
    from evaluation.cli.demo import demonstrate

    demonstrate(opened, workers, out)


def main() -> None:
    """Run the command; whatever is wrong with its arguments is one line, and exit status 2."""
    try:
        status = app(standalone_mode=False, prog_name="foresight")
    except UsageError as error:
        message = " ".join(error.format_message().split())
        if message:  # nothing when the command stands alone: then its help has been shown
            typer.echo(f"foresight: {message}", err=True)
        sys.exit(2)
    sys.exit(status if isinstance(status, int) else 0)


if __name__ == "__main__":
    main()
