"""`foresight report`: one page, which needs no network, from any folder of results."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.progress import track

from evaluation.execution.code import code_digest
from evaluation.execution.latest_rows import present
from evaluation.execution.store import Row, read_results
from evaluation.reports.failures import errors_of
from evaluation.reports.naming import label_of
from evaluation.reports.notes import Notes, Shown
from evaluation.reports.published import compared
from evaluation.reports.replay import Replay, replay
from evaluation.reports.sections import Section, section
from foresight_env import __version__
from foresight_env.files import write_atomically

METHOD_COLUMNS = ("ego", "predictor", "method")
"""Of rows: whose trial it is."""


@dataclass(frozen=True)
class Figure:
    """A figure on the page and in a paper."""

    name: str
    caption: str
    png: Path
    pdf: Path

    @property
    def data(self) -> str:
        """The PNG as a URL that holds it."""
        return "data:image/png;base64," + base64.b64encode(self.png.read_bytes()).decode()


@dataclass(frozen=True)
class Chapter:
    """One study, ready for the page."""

    section: Section
    kept: list[Shown | str]
    failures: list[tuple[str, int, int, str]]
    """Method, trials, failed trials, error of the first of these."""
    published: Sequence[tuple[str, str, str, str]]
    """The quantity, then the reference's number, the paper's and ours."""
    figures: list[Figure]
    replays: list[tuple[Replay, str]]
    """With why they were chosen."""


def write_report(folder: Path, episodes: int = 4) -> Path:
    """Write `report.html` and `figures/` into a folder of results; the page's path.

    All studies in it and below are reported: settings, tables, figures (PNG and PDF), failures, and
    up to `episodes` episodes per study, run again, to step through. `ValueError`: there are none.
    """
    manifests = sorted(folder.rglob("manifest.json")) if folder.is_dir() else []
    if not manifests:
        raise ValueError(f"{folder}: holds no results (no manifest.json in it or below)")
    found = [read_results(path.parent) for path in manifests]
    begun = [results for results in found if results.rows]
    if not any(not row["error"] for results in begun for row in results.rows):
        raise ValueError(f"{folder}: no trial has finished yet; run the study first")
    chapters = []
    for everything in begun:
        notes = Notes()
        results, old = present(everything)
        part = section(results, notes)
        if old:
            notes.print(f"{old} trials of agents with other settings, made earlier, are left out.")
        where = results.folder.relative_to(folder)
        figures = _drawn(part, folder / "figures", "_".join(where.parts))
        replays = []
        for w in track(part.episodes[:episodes], f"replays: {where}", transient=True):
            try:
                replays.append((replay(w.ego, w.seed, w.setting, w.title), w.why))
            except (
                ValueError,
                ImportError,
            ) as error:  # a user's ego, not importable here
                notes.print(f"No replay of {w.ego}: {error}", markup=False)
        chapters.append(
            Chapter(
                part,
                notes.kept,
                _failures(results.rows),
                compared(results),
                figures,
                replays,
            )
        )
    path = folder / "report.html"
    write_atomically(path, _page(folder, chapters).encode())
    return path


def _drawn(part: Section, folder: Path, prefix: str) -> list[Figure]:
    figures = []
    for name, (draw, caption) in part.figures.items():
        stem = f"{prefix}_{name}" if prefix else name
        png, pdf = (draw(folder / f"{stem}.{kind}") for kind in ("png", "pdf"))
        figures.append(Figure(name, caption, png, pdf))
    return figures


def _failures(rows: Sequence[Row]) -> list[tuple[str, int, int, str]]:
    """Per method: trials, how many of them failed, and the first error."""
    column = next((name for name in METHOD_COLUMNS if name in rows[0]), None)
    methods: dict[str, list[Row]] = {}
    for row in rows:
        methods.setdefault(row[column] if column else "all", []).append(row)
    found = []
    for name, mine in methods.items():
        errors = errors_of(mine)
        found.append((name, len(mine), len(errors), errors[0] if errors else ""))
    return found


def _page(folder: Path, chapters: Sequence[Chapter]) -> str:
    templates = Environment(
        loader=PackageLoader("evaluation.reports"), autoescape=True, undefined=StrictUndefined
    )
    templates.filters |= {"label": label_of}
    replays: list[Any] = [shown.data for chapter in chapters for shown, _ in chapter.replays]
    text: str = templates.get_template("report.html").render(
        name=folder.resolve().name,
        chapters=chapters,
        replays=replays,
        is_table=lambda thing: isinstance(thing, Shown),
        version=__version__,
        code=code_digest(),
    )
    return text
