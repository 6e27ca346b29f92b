"""`foresight evaluate eth-ucy` and `foresight export`: the field's prediction protocols."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.registry import LEARNED
from evaluation.cli.options import (
    PREDICTOR_NAMES,
    ClusterOption,
    OutOption,
    WorkersOption,
    chosen_agents,
    chosen_workers,
    listed,
    plain_errors,
)

SCENE_NAMES = ("eth", "hotel", "univ", "zara1", "zara2")
"""Of `evaluation.windows.eth_ucy`, which loads NumPy."""
NETWORKS = tuple(name for name in LEARNED if name in PREDICTOR_NAMES)
DEFAULT = (
    "constant-velocity", "constant-velocity-sampled", "constant-acceleration", "kalman",
    "social-force", "orca",
)  # fmt: skip


@plain_errors
def evaluate_eth_ucy(
    data: Annotated[
        Path, typer.Option(help="Folder with the scenes' obsmat.txt files, in it or below.")
    ],
    predictors: Annotated[
        str,
        typer.Option(
            help=f"Comma-separated, of {', '.join(PREDICTOR_NAMES)}; your own as module:Class."
        ),
    ] = ",".join(DEFAULT),
    scenes: Annotated[
        str, typer.Option(help="Comma-separated; all five for the average.")
    ] = ",".join(SCENE_NAMES),
    weights: Annotated[
        Path | None,
        typer.Option(
            help="Folder of weights trained without the scene that they predict: "
            f"SCENE/NAME.safetensors for {', '.join(NETWORKS)}; "
            "your own class is given WEIGHTS/SCENE if it takes `weights`. Default: those "
            "of the library.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, help="Take every n-th window, for a quick look; 1: the protocol.")
    ] = 1,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path("results/eth_ucy"),
) -> None:
    """ETH/UCY, one scene left out: 8 observed and 12 predicted steps, positions only.

    Tables by scene next to published numbers, all numbers as CSV, a page in Markdown.
    Interrupted studies are resumed; more --predictors or --scenes are added to what is there.
    """
    names = chosen_agents("--predictors", predictors, PREDICTOR_NAMES)
    places = listed("--scenes", scenes, SCENE_NAMES)
    from evaluation.reports.eth_ucy import (
        curves,
        draw_reliability,
        print_eth_ucy,
        write_csv,
        write_markdown,
    )
    from evaluation.reports.terminal import terminal
    from evaluation.studies.eth_ucy import study

    rows = study(
        out / "study",
        data,
        names,
        scenes=places,
        weights=weights,
        every=every,
        workers=chosen_workers(workers, cluster),
    )
    console = terminal()
    print_eth_ucy(console, rows, every=every)
    written = {
        "numbers": write_csv(rows, out / "eth_ucy.csv"),
        "page": write_markdown(rows, out / "eth_ucy.md", every=every),
    }
    if curves(rows):
        written["picture"] = draw_reliability(rows, out / "reliability.png")
    for what, path in written.items():
        console.print(f"{what}: {path}", soft_wrap=True, markup=False)


@plain_errors
def export(
    data: Annotated[
        Path, typer.Argument(help="Folder of recordings (inD, DUT, UCY, ETH), or a file.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for tensors.npz and steps.parquet.")] = Path(
        "results/export"
    ),
) -> None:
    """Recordings as tensors of 8 observed and 12 predicted steps of 0.4 s, for your own training.

    The windows and histories of `foresight evaluate eth-ucy`, for any recordings; windows of a
    single agent as well.
    """
    from evaluation.training.export import export_recordings

    tensors = export_recordings(data, out)
    agents = int(tensors.counted.sum())
    typer.echo(f"histories: {len(tensors.frame)}, agents that count: {agents}")
    for name in ("tensors.npz", "steps.parquet"):
        typer.echo(f"{name}: {out / name}")
