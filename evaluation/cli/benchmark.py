"""`foresight benchmark`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.registry import PLANNED, SCENE_PREDICTORS, check_extra
from evaluation.cli.options import (
    ALL_EGO_NAMES,
    ALL_PREDICTOR_NAMES,
    PREDICTOR_NAMES,
    ClusterOption,
    OutOption,
    Split,
    WorkersOption,
    chosen_agents,
    chosen_workers,
    listed,
    plain_errors,
)
from foresight_env.names import DRIVING_BEHAVIOURS, PLACES

PLANNED_NAMES = tuple(f"{name}{PLANNED}" for name in PREDICTOR_NAMES if name != "constant-velocity")
"""The ego "constant-velocity" is the planner with that predictor already."""


@plain_errors
def benchmark(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of recordings (inD, DUT, UCY) for the open loop; without it, simulated "
            "episodes alone."
        ),
    ] = None,
    split: Annotated[
        Split, typer.Option(help="Of the recordings; settings were chosen on development.")
    ] = "test",
    scenarios: Annotated[
        str,
        typer.Option(help=f"Comma-separated, of {', '.join(PLACES)}; empty for none."),
    ] = ",".join(PLACES),
    others: Annotated[
        str,
        typer.Option(
            help=f"What drives the other cars, comma-separated, of {', '.join(DRIVING_BEHAVIOURS)}."
        ),
    ] = "receding",
    predictors: Annotated[
        str,
        typer.Option(
            help="Comma-separated names or module:Class; all, or empty for none. Those that need "
            f"the place's game ({', '.join(SCENE_PREDICTORS)}) are left out of the recordings."
        ),
    ] = "all",
    egos: Annotated[
        str,
        typer.Option(
            help="Comma-separated names, PREDICTOR+plan or module:Class; all (the registered egos "
            "and the planner with every predictor), or empty for none."
        ),
    ] = "all",
    episodes: Annotated[int, typer.Option(min=1, help="Seeds per scenario.")] = 10,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/benchmark"),
) -> None:
    """Predictors and egos at every place, open loop and closed loop: tables, a CSV and a page.

    An interrupted benchmark is resumed; more methods, scenarios or episodes are added
    to what is there.
    """
    from evaluation.reports.benchmark import benchmark as run
    from evaluation.studies.benchmark import BenchmarkConfiguration

    configuration = BenchmarkConfiguration(
        listed("--scenarios", scenarios, PLACES) if scenarios else (),
        listed("--others", others, DRIVING_BEHAVIOURS),
        _names("--predictors", predictors, ALL_PREDICTOR_NAMES),
        _names("--egos", egos, (*ALL_EGO_NAMES, *PLANNED_NAMES)),
        episodes,
    )
    if not (configuration.places or data):
        raise ValueError("--scenarios, --data: are both empty; there is nothing to run")
    if not (configuration.predictors or configuration.egos):
        raise ValueError("--predictors, --egos: are both empty; there is nothing to run")
    run(configuration, data, split, chosen_workers(workers, cluster), out)


def _names(option: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    if text == "all":
        for name in known:
            check_extra(name)
        return known
    return chosen_agents(option, text, known) if text else ()
