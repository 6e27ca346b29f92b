"""`foresight value`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from evaluation.cli.options import (
    ALL_EGO_NAMES,
    ClusterOption,
    OutOption,
    SafetyFilterOption,
    SeedsOption,
    WorkersOption,
    chosen_agents,
    chosen_seeds,
    chosen_workers,
    listed,
    plain_errors,
)

Bound = Literal["clairvoyant", "know-gamma", "oracle"]
"""Egos that the baseline is compared with."""
DEFAULT_EGOS = ("oracle", "know-gamma", "infer-gamma", "constant-velocity")


@plain_errors
def value(
    settings: Annotated[
        str, typer.Option(help="Comma-separated names of settings, or all; --list prints them.")
    ] = "crowd-3-short",
    episodes: Annotated[int, typer.Option(min=1, help="Seeds per setting.")] = 40,
    seeds: SeedsOption = "test",
    egos: Annotated[
        str,
        typer.Option(help="Comma-separated, in addition to the baseline assume-gamma-1."),
    ] = ",".join(DEFAULT_EGOS),
    bound: Annotated[
        Bound,
        typer.Option(
            help="clairvoyant: the best response that a search by simulation finds, offline; "
            "know-gamma: the ego infer-gamma with the true discount factors; oracle: the others' "
            "own equilibrium."
        ),
    ] = "clairvoyant",
    names: Annotated[
        bool,
        typer.Option("--list", help="Print the settings, with the range of the others' gamma."),
    ] = False,
    safety_filter: SafetyFilterOption = True,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/value"),
) -> None:
    """Value of knowing the others' foresight, and how much of it each ego gets.

    The value of information is what the ego that assumes gamma = 1 loses to the bound, in cost,
    time and collisions, on the same seeds. Interrupted studies are resumed. With the
    clairvoyant, ten seeds of a crowd take one to three minutes on one core.
    """
    from evaluation.rollout.places import SETTINGS

    if names:
        for name, setting in SETTINGS.items():
            low, high = setting.gammas
            typer.echo(f"{name:20}{setting.scenario}, others' gamma in ({low:g}, {high:g})")
        return
    chosen = (
        tuple(SETTINGS) if settings == "all" else listed("--settings", settings, tuple(SETTINGS))
    )
    compared = tuple(
        dict.fromkeys((*chosen_agents("--egos", egos, ALL_EGO_NAMES), "assume-gamma-1"))
    )
    if bound != "clairvoyant":
        compared = tuple(dict.fromkeys((bound, *compared)))
    chosen_episodes = chosen_seeds(seeds, episodes)
    from evaluation.reports.terminal import terminal
    from evaluation.reports.value import print_value, value_figure
    from evaluation.studies.value import study

    rows = study(
        out / "episodes",
        chosen,
        compared,
        chosen_episodes,
        workers=chosen_workers(workers, cluster),
        clairvoyant=bound == "clairvoyant",
        safety_filter=safety_filter,
    )
    console = terminal()
    print_value(console, rows, chosen, compared, bound)
    shown = tuple(dict.fromkeys((bound, *compared)))
    picture = value_figure(rows, chosen, shown, out / "value.png")
    console.print(f"picture: {picture}", soft_wrap=True, markup=False)
