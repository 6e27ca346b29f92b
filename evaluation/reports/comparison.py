"""`foresight report DIR --markdown FILE`: the paper, its reference and these results together."""

from __future__ import annotations

from pathlib import Path

from evaluation.execution.latest_rows import present
from evaluation.execution.store import Results, read_results
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.lines import markdown_table
from evaluation.reports.published import compared
from foresight_env.files import write_atomically

TITLES = {
    "estimation": "Crosswalk: inferring foresight",
    "intersection": "Intersection: a window of people and cars",
    "driving": "Driving: an unprotected left turn (among game agents / among IDM cars)",
}
"""By a study's name; others have no published numbers."""
NOTES = {
    "estimation": "The reference's descents begin at the true parameters, this library's at random "
    "discount factors and last observed positions. From noisy positions alone speeds are hardly "
    "seen: a descent that begins at the truth and stays near it then errs less than the best fit "
    "does, and assume-gamma-1 fits about as well as infer-gamma. The bound is that of small noise: "
    "from positions, limits on speeds and discount factors keep errors below it.",
    "intersection": "The reference's window is one of inD's. Without it (`make paper DATA=...`) "
    "the study runs on a recording that the project makes itself: then errors do not compare, only "
    "what is saved by inferring gamma does.",
}
HEAD = """# Results and the paper's

Written by `make paper`; what else was measured is in [measurements](measurements.md). *Reference*:
the implementation that the paper's authors published; *paper*: its statements. A dash: nothing is
said.
"""


def write_comparison(folder: Path, path: Path) -> Path:
    """Write the Markdown page of all studies in and below a folder; its path.

    `ValueError`: none of them has published numbers.
    """
    manifests = sorted(folder.rglob("manifest.json"))
    found = [present(read_results(manifest.parent))[0] for manifest in manifests]
    sections = [_section(results) for results in found if results.study in TITLES and results.rows]
    if not sections:
        raise ValueError(f"{folder}: holds no study that the paper has numbers of")
    write_atomically(path, "\n".join([HEAD, *sections]).encode())
    return path


def _section(results: Results) -> str:
    counted = f"{len(results.rows)} trials, {failed(errors_of(results.rows))}"
    made = f"{results.machine}, foresight_env {results.version}, code {results.code}."
    lines = [f"## {TITLES[results.study]}", "", f"{counted}. {made}", ""]
    if results.study in NOTES:
        lines += [NOTES[results.study], ""]
    lines += markdown_table(("measured", "reference", "paper", "this library"), compared(results))
    return "\n".join(lines)
