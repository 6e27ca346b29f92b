"""`foresight generate` and `foresight train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from agents.registry import FORECASTERS, HYBRID
from evaluation.cli.options import (
    ClusterOption,
    OutOption,
    WorkersOption,
    chosen_workers,
    listed,
    plain_errors,
)
from evaluation.cli.protocols import SCENE_NAMES
from evaluation.training.names import PPO, SPLITS, TRAINABLE
from foresight_env.extras import require
from foresight_env.names import PLACES

EPISODES = "results/episodes"
"""Folder of episodes, unless another is named."""


@plain_errors
def generate(
    scenarios: Annotated[
        str, typer.Argument(help=f"Comma-separated, of {', '.join(PLACES)}.")
    ] = "crosswalk",
    episodes: Annotated[int, typer.Option(min=1, help="Of every scenario.")] = 100,
    split: Annotated[
        str, typer.Option(help=f"One of {', '.join(SPLITS)}: each has its own seeds.")
    ] = "train",
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: OutOption = Path(EPISODES),
) -> None:
    """Make a data set of episodes: states, observations, controls, goals, discount factors.

    In OUT/SPLIT, as Parquet; what is there already is kept.
    """
    places = listed("SCENARIOS", scenarios, PLACES)
    if split not in SPLITS:
        raise ValueError(f"--split: is {split!r}; choose from {', '.join(SPLITS)}")
    from evaluation.reports.failures import errors_of, failed
    from evaluation.training.generation import generate as run

    rows = run(out / split, places, episodes, split, chosen_workers(workers, cluster))
    errors = errors_of(rows)
    typer.echo(f"episodes: {len(rows) - len(errors)} in {out / split}")
    if errors:
        typer.echo(failed(errors), err=True)


@plain_errors
def train(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(TRAINABLE)}.")],
    episodes: Annotated[
        str, typer.Option(help="Folders of foresight generate, comma-separated; ppo needs none.")
    ] = EPISODES,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of recordings; those that tests are made on are left out. hybrid-game "
            "learns from these alone, or without them from episodes."
        ),
    ] = None,
    hold_out: Annotated[
        str | None,
        typer.Option(
            help="Of predictors: scene of the ETH/UCY protocol that the weights will be tested on; "
            f"they learn from the others of --data: {', '.join(SCENE_NAMES)}.",
            show_default=False,
        ),
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, help="At most. Default: the network's own.")
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, help="Examples per step (of ppo: steps per update).")
    ] = None,
    rate: Annotated[float | None, typer.Option(min=0.0, help="Learning rate at the start.")] = None,
    decay: Annotated[float | None, typer.Option(min=0.0, help="Of weights (AdamW).")] = None,
    patience: Annotated[
        int | None, typer.Option(min=1, help="Epochs without a better validation that end it.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of weights and order.")] = 0,
    out: OutOption = Path("results/training"),
) -> None:
    """Train a network; training resumes after interruption, with the same result.

    OUT/NAME gets the weights, what they are of, and the learning curve.
    """
    listed("NAME", name, TRAINABLE)
    if data is not None and name not in (*FORECASTERS, HYBRID):
        raise ValueError(f"--data: {name} learns from episodes only; leave it out")
    if name == HYBRID and data is not None and episodes != EPISODES:
        raise ValueError("--episodes: hybrid-game learns from --data alone; leave one of them out")
    if hold_out is not None:
        if name not in (*FORECASTERS, HYBRID):
            raise ValueError(f"--hold-out: {name} is no predictor; leave it out")
        listed("--hold-out", hold_out, SCENE_NAMES)
        if data is None:
            raise ValueError("--hold-out: needs --data, the folder of the protocol's scenes")
    require("learned", "train")
    if name == PPO:
        require("rl", f"train {PPO}")
    from dataclasses import replace

    from agents.learned.training import Epoch, Schedule

    def on_epoch(epoch: Epoch) -> None:
        typer.echo(f"epoch {epoch.number}: {epoch.train:.4f}, validation {epoch.validation:.4f}")

    folders = [Path(part.strip()) for part in episodes.split(",") if part.strip()]
    chosen: dict[str, Any] = {
        "epochs": epochs, "batch": batch, "rate": rate, "decay": decay, "patience": patience,
    }  # fmt: skip
    chosen = {option: value for option, value in chosen.items() if value is not None}
    schedule = Schedule(**chosen, seed=seed)
    if hold_out is not None:
        out = out / hold_out
    if name == HYBRID:
        from evaluation.training.hybrid import PROPOSING, train_hybrid
        from evaluation.training.hybrid_data import leave_one_out, recorded, simulated

        if data is None:
            examples = simulated(folders)
        elif hold_out is None:
            examples = recorded(data)
        else:
            examples = leave_one_out(data, hold_out)
        first = replace(PROPOSING, **chosen, seed=seed)
        found = train_hybrid(examples, out / name, first, on_epoch)
    elif name == PPO:
        from evaluation.training.reinforcement import reinforce

        found = reinforce(out / name, schedule, on_epoch)
    else:
        from evaluation.training.supervised import learn

        found = learn(name, folders, data, out / name, schedule, on_epoch, hold_out=hold_out)
    best = found.curve[found.best]
    typer.echo(f"kept: epoch {best.number}, validation {best.validation:.4f}")
    typer.echo(f"weights: {out / name / f'{name}.safetensors'}")
    typer.echo(f"curve: {out / name / 'curve.png'}")
