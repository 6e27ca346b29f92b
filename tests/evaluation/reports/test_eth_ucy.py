"""Tables of the ETH/UCY protocol from rows with known numbers."""

import csv
import io

import numpy as np
import pytest
from rich.console import Console

from evaluation.metrics.calibration import BINS
from evaluation.metrics.ranks import LEAST_GROUPS
from evaluation.reports.eth_ucy import (
    AVERAGE,
    BLOCK_SECONDS,
    curves,
    draw_reliability,
    error_lines,
    numbers,
    print_eth_ucy,
    write_csv,
    write_markdown,
)
from evaluation.reports.published_prediction import ETH_UCY
from evaluation.windows.eth_ucy import SCENES

BLOCKS = 6


def rows(predictor, offset, levels=None, blocks=BLOCKS):
    """Two agents in each block of each scene; errors are 1, 2, ... by scene, plus an offset."""
    found = []
    for k, (scene, rule) in enumerate(SCENES.items()):
        for block in range(blocks):
            error = 1.0 + k + offset
            found.append(
                {
                    "scene": scene,
                    "recording": scene,
                    "frame": int(block * BLOCK_SECONDS * rule.rate),
                    "predictor": predictor,
                    "agents": ["1", "2"],
                    "ade": [error, error + 2.0],
                    "fde": [2.0 * error, 2.0 * error],
                    "best_ade": [0.5 * error, 0.5 * error],
                    "best_fde": [error, error],
                    "missed": [0, 1],
                    "nll": None if levels is None else [1.0, 3.0],
                    "levels": levels,
                    "overlaps": 3,
                    "overlaps_recorded": 2,
                    "fallbacks": 0,
                    "seconds": [0.001 * (1 + block)],
                    "error": "",
                }
            )
    return found


EVEN = [2] * BINS
BOTH = [*rows("constant-velocity", 0.0), *rows("kalman", 0.5, EVEN)]


def test_averages_are_of_the_scenes():
    found = {(n.predictor, n.scene): n for n in numbers(BOTH)}
    velocity, kalman = found["constant-velocity", AVERAGE], found["kalman", AVERAGE]
    assert found["constant-velocity", "eth"].ade == pytest.approx(2.0)
    assert found["constant-velocity", "zara2"].fde == pytest.approx(10.0)
    assert velocity.ade == pytest.approx(4.0)
    assert (velocity.agents, velocity.windows, velocity.blocks) == (60, 30, 30)
    assert velocity.missed == 0.5
    assert np.isnan([velocity.nll, velocity.coverage_50]).all()
    assert (kalman.nll, kalman.coverage_50, kalman.coverage_90) == pytest.approx((2.0, 0.5, 0.9))
    assert (kalman.collisions, kalman.collisions_recorded) == (90, 60)
    assert kalman.latency_p50_ms == pytest.approx(3.5)
    assert velocity.gaps == {}
    # The same difference for every agent: no spread.
    assert kalman.gaps["ade"] == pytest.approx((0.5, 0.5, 0.5))
    assert found["kalman", "eth"].gaps["best_fde"] == pytest.approx((0.5, 0.5, 0.5))


def test_few_blocks_have_no_interval():
    few = [*rows("constant-velocity", 0.0, None, 4), *rows("kalman", 0.5, EVEN, 4)]
    assert len(few) // 10 < LEAST_GROUPS
    gap = next(n for n in numbers(few) if (n.predictor, n.scene) == ("kalman", AVERAGE)).gaps["ade"]
    assert gap.mean == pytest.approx(0.5)
    assert np.isnan(gap.low)


def test_windows_that_one_predictor_lacks_are_left_out():
    failed = {**BOTH[0], "error": "ValueError: no luck"}
    found = numbers([failed, *BOTH[1:]])
    counts = {(n.predictor, n.scene): n.windows for n in found}
    assert counts["constant-velocity", "eth"] == counts["kalman", "eth"] == BLOCKS - 1
    assert counts["kalman", "hotel"] == BLOCKS
    console = Console(file=io.StringIO(), width=200)
    print_eth_ucy(console, [failed, *BOTH[1:]])
    assert "1 prediction failed; first: ValueError: no luck" in console.file.getvalue()


def test_published_numbers_stand_next_to_averages():
    lines = error_lines(numbers(BOTH), 20)
    assert lines[0][AVERAGE] == "1.50 / 3.00"
    published = [line for line in lines if "published" in str(next(iter(line.values())))]
    assert len(published) == sum(p.futures == 20 for p in ETH_UCY)
    assert published[0][AVERAGE] == "0.28 / 0.56"
    assert published[0]["eth"] == ""
    # Without all scenes there is no average to compare.
    part = [row for row in BOTH if row["scene"] != "univ"]
    assert len(error_lines(numbers(part), 20)) == 2


def test_files(tmp_path):
    with write_csv(BOTH, tmp_path / "a" / "numbers.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert len(lines) == 2 * 6 + len(ETH_UCY)
    kalman = next(e for e in lines if (e["predictor"], e["scene"]) == ("kalman", AVERAGE))
    assert float(kalman["ade"]) == pytest.approx(4.5)
    assert float(kalman["ade_gap_low"]) == pytest.approx(0.5)
    assert lines[0]["nll"] == ""
    assert lines[-1]["source"].startswith("published: ")
    page = write_markdown(BOTH, tmp_path / "page.md", every=3).read_text()
    assert "| kalman | 2.50 / 3.00 |" in page
    assert "one window in 3: not the protocol" in page
    assert "+0.500 [+0.500, +0.500]" in page
    assert "one window in" not in write_markdown(BOTH, tmp_path / "page.md").read_text()
    assert curves(BOTH).keys() == {"kalman"}
    np.testing.assert_allclose(curves(BOTH)["kalman"], np.arange(1, BINS + 1) / BINS)
    assert draw_reliability(BOTH, tmp_path / "picture.png").stat().st_size > 10_000
