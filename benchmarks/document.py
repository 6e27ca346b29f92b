"""docs/development/benchmarks.md: one part per study, each with its own date and machine.

Studies take up to half an hour each, so every one is written as soon as it ends; the others' parts
stay as they are.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version

from benchmarks.report import Result
from benchmarks.timing import ROOT, Yardstick, processor
from evaluation.execution.store import write_atomically
from foresight_env import __version__

DOCUMENT = ROOT / "docs" / "development" / "benchmarks.md"
HEADING = """# Benchmarks

Written by `make bench`, one study after the other; do not edit. Times in brackets are multiples of
the yardstick (y): the median time of a single-threaded 500 x 500 `numpy.linalg.solve` on the same
machine, measured with each study.
"""
MARK = "<!-- study: {} -->"


def circumstances() -> str:
    """Date, machine, versions and yardstick of this moment."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (
        f"{datetime.now(UTC):%Y-%m-%d}; {processor()}, {cores} cores, {platform.system()}; "
        f"foresight_env {__version__}, Python {platform.python_version()}, {packages}; "
        f"yardstick {1e3 * Yardstick.measure().seconds:.2f} ms"
    )


def parts_of(text: str) -> dict[str, str]:
    """The document's parts by study."""
    pieces = re.split(MARK.format(r"(\w+)"), text)
    return {name: part.strip() for name, part in zip(pieces[1::2], pieces[2::2], strict=True)}


def compose(parts: dict[str, str], order: Sequence[str]) -> str:
    """The document from its parts; those of studies that there are no longer fall out."""
    known = [f"{MARK.format(name)}\n\n{parts[name]}\n" for name in order if name in parts]
    return "\n".join([HEADING, *known])


def record(study: str, results: Sequence[Result], measured: str, order: Sequence[str]) -> None:
    """Replace one study's part; `measured` says when and where."""
    old = DOCUMENT.read_text(encoding="utf-8") if DOCUMENT.exists() else ""
    part = "\n".join([*(result.markdown() for result in results), f"*{measured}.*"])
    text = compose({**parts_of(old), study: part}, order)
    write_atomically(DOCUMENT, text.encode())
