"""`python -m benchmarks [--quick] [--only NAME] [--data DIR] [--reference DIR]`."""

from __future__ import annotations

import importlib
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.document import DOCUMENT, circumstances, record
from benchmarks.report import Arguments
from benchmarks.timing import ROOT
from evaluation.reports.terminal import terminal


class Study(StrEnum):
    """Modules of this package, in the order in which they run."""

    FORWARD = "forward"
    BATCH = "batch"
    ACCELERATOR = "accelerator"
    GROWTH = "growth"
    MERGE = "merge"
    DERIVATIVES = "derivatives"
    LINEAR_STEP = "linear_step"
    RIVALS = "rivals"
    INVERSE = "inverse"
    ACCURACY = "accuracy"
    INTERVALS = "intervals"
    ONLINE = "online"
    EGOS = "egos"
    LEARNED_GAMMA = "learned_gamma"
    INTERSECTION = "intersection"
    SYNTHETIC_WINDOWS = "synthetic_windows"
    STRESS = "stress"
    ENVIRONMENT = "environment"
    VECTOR = "vector"
    DRIVING = "driving"
    PREDICTION = "prediction"
    HYBRID = "hybrid"
    WORST_WINDOWS = "worst_windows"
    VELOCITY_LEAK = "velocity_leak"
    PROTOCOL_RULES = "protocol_rules"
    WINDOWS = "windows"
    RECORDINGS = "recordings"
    SENSITIVITY = "sensitivity"
    ROBUSTNESS = "robustness"


def main(
    quick: Annotated[
        bool, typer.Option(help="Fewer repeats: minutes instead of hours, and nothing written.")
    ] = False,
    only: Annotated[Study | None, typer.Option(help="One study.")] = None,
    data: Annotated[
        Path | None,
        typer.Option(exists=True, file_okay=False, help="Folder with DUT and UCY recordings."),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            exists=True, file_okay=False, help="Folder with the reference's raw errors, to draw."
        ),
    ] = None,
) -> None:
    """Measure speed and accuracy; full studies are written to docs/development/benchmarks.md."""
    console = terminal()
    arguments = Arguments(console, quick, data, reference)
    for study in Study if only is None else (only,):
        measured = circumstances()
        console.print(f"{study.value}: {measured}")
        results = importlib.import_module(f"benchmarks.{study.value}").run(arguments)
        if not quick and any(result.rows for result in results):
            record(study.value, results, measured, list(Study))
            console.print(f"written: {DOCUMENT.relative_to(ROOT)}")


if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    app()
