"""Failed trials are counted, and the first error is shown, wherever a study is reported."""

import io

import pytest
from rich.console import Console

from evaluation.execution.store import Store
from evaluation.reports.comparison import write_comparison
from evaluation.reports.driving import print_driving
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.intersection import print_errors
from evaluation.reports.tables import print_closed_loop, print_estimation
from evaluation.studies import estimation
from evaluation.studies.closed_loop import summarise
from tests.support.made_rows import episode_rows, estimation_rows

ERRORS = ("ValueError: [no] luck (file.py:3)", "OSError: none either (file.py:4)")


def with_failures(rows):
    """The rows, two of them failed."""
    found = [{**row, "error": error} for row, error in zip(rows, ERRORS, strict=False)]
    return [*found, *rows[len(found) :]]


def test_words():
    assert failed([]) == "0 trials failed"
    assert failed(ERRORS[:1]) == f"1 trial failed; first: {ERRORS[0]}"
    assert failed(ERRORS) == f"2 trials failed; first: {ERRORS[0]}"
    assert errors_of([{"error": ""}, {"error": "x"}]) == ["x"]


def closed_loop(console):
    rows = with_failures(episode_rows())[:-1]
    print_closed_loop(console, [summarise(rows, "infer-gamma")], rows)


def open_loop(console):
    print_estimation(console, with_failures([{**r, "seconds": 0.1} for r in estimation_rows()]))


def driving(console):
    rows = [{"scene": "merge", "others": "idm", "ego": "idm", "error": e} for e in ERRORS]
    print_driving(console, rows, ("merge",), ("idm",), ("idm",))


def intersection(console):
    made = {"average_displacement": 1.0, "solved": True}
    print_errors(console, with_failures([{**r, **made} for r in estimation_rows()]))


@pytest.mark.parametrize("report", [closed_loop, open_loop, driving, intersection])
def test_tables(report):
    console = Console(file=io.StringIO(), width=200)
    report(console)
    assert f"2 trials failed; first: {ERRORS[0]}" in console.file.getvalue()


def test_the_comparison_with_the_paper(tmp_path):
    rows = with_failures([{**r, "seconds": 0.1} for r in estimation_rows()])
    Store(tmp_path / "s", "estimation", {}, estimation.KEY).append(rows)
    page = write_comparison(tmp_path, tmp_path / "page.md").read_text()
    assert f"2 trials failed; first: {ERRORS[0]}" in page
