"""The leaderboard: a page from the tables of studies alone."""

from pathlib import Path

import numpy as np
import pytest

from evaluation.reports.benchmark_results import class_part, common, open_part, write_csv
from evaluation.reports.leaderboard import read_tables, write_leaderboard

WINDOWS = 12


def predicted(error, covariance=True):
    levels = [0] * 20
    levels[3] = levels[15] = 1  # one position of two is in the 50 % region
    return {
        "average_error": error, "final_error": 2 * error, "missed": 1, "agents": 2,
        "best_average_error": error, "nll": 1.5 if covariance else None,
        "levels": levels if covariance else None, "overlaps": 3, "overlaps_recorded": 2,
        "seconds": [0.001], "failed": 0,
    }  # fmt: skip


def methods(good=0.5, bad=1.0):
    def cases(base, covariance):
        return {k: (k, predicted(base + 0.01 * np.sin(k), covariance)) for k in range(WINDOWS)}

    return common({"good": cases(good, True), "bad": cases(bad, False)})


@pytest.fixture
def folder(tmp_path):
    parts = (
        open_part("DUT, test", methods(), {}),
        class_part("DUT, test, people", methods(1.0, 0.5)),
        open_part("crosswalk", methods(), {}),
    )
    write_csv(parts, tmp_path / "benchmark.csv")
    return tmp_path


def test_the_page_has_every_method_with_ranks_and_intervals(folder):
    text = write_leaderboard(folder, folder / "page.md").read_text()
    assert (
        "Of the predictors that enter every table `good` has rank 1.0 on average and may be first "
        "in 2 of 2;"
    ) in text
    assert "`bad` has rank 2.0 on average and may be first in 0 of 2." in text
    row = next(line for line in text.splitlines() if line.startswith("| `good` | 1.0 |"))
    cells = [cell.strip() for cell in row.split("|")[1:-1]]
    assert cells[2:] == ["**0.50** 1", "1.00 2", "**0.50** 1"]
    whole = next(line for line in text.splitlines() if line.startswith("| `good` | **1** |"))
    cells = [cell.strip() for cell in whole.split("|")[1:-1]]
    low, high = (float(v) for v in cells[3].strip("[]").split(","))
    assert low <= float(cells[2]) <= high
    assert cells[4:9] == ["50", "0.50", "1.50", "50 / 100", "36 / 24"]
    assert "## DUT, test, people: 12 agents" in text


def test_scenes_and_published_numbers_are_in_it(folder):
    (folder / "eth_ucy.csv").write_text(
        "predictor,scene,agents,ade,fde,best_ade,best_fde,source\n"
        "good,eth,7,0.5,1.0,0.2,0.3,measured\n"
        "good,average,9,0.4,0.8,0.1,0.2,measured\n"
        "bad,eth,7,0.6,1.1,0.6,1.1,measured\n"
        "bad,average,9,0.6,1.1,0.6,1.1,measured\n"
        "Net,average,,,,0.18,0.29,published: A et al.\n"
    )
    text = write_leaderboard(folder, folder / "page.md").read_text()
    assert "measured on 9 agents" in text
    assert "| `good` | 1 | 0.50 / 1.00 | 0.40 / 0.80 |" in text
    assert "| `good` | 20 | 0.20 / 0.30 | 0.10 / 0.20 |" in text
    assert "| `bad` | 1 | 0.60 / 1.10 | 0.60 / 1.10 |" in text
    assert "| `bad` | 20 |" not in text  # its only future
    assert "| published: A et al.: Net | 20 | - | 0.18 / 0.29 |" in text


def test_a_file_that_is_no_table_of_the_benchmark_is_named(tmp_path):
    (tmp_path / "benchmark.csv").write_text("loop,place\nopen loop,x\n")
    with pytest.raises(ValueError, match=r"benchmark.csv, line 2: is not of a benchmark"):
        read_tables(tmp_path / "benchmark.csv")


def test_the_documentation_has_the_page_of_its_tables(tmp_path):
    docs = Path(__file__).parents[3] / "docs"
    made = write_leaderboard(docs / "data", tmp_path / "page.md").read_text()
    assert made == (docs / "leaderboard.md").read_text()
