"""Results of a training: weights, their description and the learning curve."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from agents.learned.training import Epoch, Trained
from agents.learned.weights import packed
from evaluation.reports.figures import save
from foresight_env.files import write_atomically


def write_trained(
    folder: Path, name: str, trained: Trained, about: dict[str, Any], seconds: float
) -> None:
    """Write `NAME.safetensors`, `NAME.json`, `curve.csv`, `curve.png` and `last_run.json`.

    `about` joins what `NAME.json` says of the training itself. `seconds`: of this run; a training
    that was interrupted took longer.
    """
    description = {
        **about,
        "epochs": len(trained.curve),
        "best_epoch": trained.best,
        "best_loss": trained.curve[trained.best].validation,
    }
    write_atomically(folder / f"{name}.safetensors", packed(trained.network))
    write_atomically(folder / f"{name}.json", (json.dumps(description, indent=2) + "\n").encode())
    _curve(trained.curve, folder)
    last = {"seconds": round(seconds, 1)}
    write_atomically(folder / "last_run.json", (json.dumps(last) + "\n").encode())


def _curve(curve: Sequence[Epoch], folder: Path) -> None:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("epoch", "train", "validation"))
    writer.writerows(curve)
    write_atomically(folder / "curve.csv", out.getvalue().encode())
    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axes = figure.subplots()
    numbers = [e.number for e in curve]
    axes.plot(numbers, [e.train for e in curve], label="train")
    axes.plot(numbers, [e.validation for e in curve], label="validation")
    best = min(curve, key=lambda e: e.validation)
    axes.axvline(best.number, color="0.5", ls=":", label="kept")
    axes.set_xlabel("epoch")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("loss")
    axes.legend()
    save(figure, folder / "curve.png")
