"""Figures are pictures of the right size that show something; the heatmap's values."""

import numpy as np
import pytest
from PIL import Image

from evaluation.reports import figures
from evaluation.studies.closed_loop import paired_difference, summarise
from evaluation.studies.heatmap import heatmap
from foresight_env.scenarios.crosswalk import HEATMAP
from tests.support.made_rows import episode_rows, estimation_rows


def check(path, width, height):
    """A PNG of that many inches at 150 dots, with more than one colour."""
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.size == (round(150 * width), round(150 * height))
        pixels = np.asarray(image.convert("L"))
    assert (pixels < 250).mean() > 0.01
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_error_against_noise(tmp_path):
    path = figures.error_against_noise(estimation_rows(), tmp_path / "new" / "error.png")
    check(path, 9.0, 3.8)


def test_closed_loop_figure(tmp_path):
    rows = episode_rows()
    path = tmp_path / "new" / "loop.png"
    check(figures.closed_loop_summary(rows, ("infer-gamma", "assume-gamma-1"), path), 9.0, 3.6)


def test_closed_loop_numbers_by_hand():
    rows = episode_rows()
    found = summarise(rows, "infer-gamma")
    assert (found.episodes, found.failed, found.reached, found.time_outs) == (3, 0, 2, 1)
    assert found.time_to_goal.mean == pytest.approx((3.0 + 10.0 + 5.0) / 3.0)
    assert found.smallest_distance == pytest.approx(0.3)
    assert found.latency_median == 25.0
    assert (found.failed_plans, found.failed_fits) == (3, 6)
    other = summarise(rows, "assume-gamma-1")
    assert (other.episodes, other.failed, other.reached) == (3, 1, 2)
    difference = paired_difference(rows, "infer-gamma", "assume-gamma-1", "time")
    assert difference == (-1.0, -1.0, -1.0)
    with pytest.raises(ValueError, match="ego oracle: no episode finished: no rows"):
        summarise(rows, "oracle")


def test_gamma_over_time(tmp_path):
    known = [{}, {1: (0.8, 0.2)}, {1: (0.7, 0.1)}]
    path = tmp_path / "new" / "gammas.png"
    drawn = figures.gamma_over_time([0.0, 0.1, 0.2], known, np.array([0.9, 0.7]), path)
    check(drawn, 8.0, 3.2)
    with_truth = drawn.read_bytes()
    drawn = figures.gamma_over_time([0.0, 0.1, 0.2], known, np.array([0.9, np.nan]), path)
    check(drawn, 8.0, 3.2)
    assert drawn.read_bytes() != with_truth  # no line of a truth that there is not


def test_a_small_heatmap(tmp_path):
    grid = heatmap(3, largest=1.18)
    np.testing.assert_allclose(grid.gammas, [0.02, 0.6, 1.18])
    for values in (grid.full, grid.positions):
        assert values.shape == (3, 3)
        assert np.nanargmin(values) == 4  # the middle is the truth
        assert values[1, 1] < 1e-8
    solved = ~np.isnan(grid.full)
    assert grid.unsolved == 9 - solved.sum()
    assert (grid.full[solved] >= grid.positions[solved]).all()
    assert grid.gammas[1] == pytest.approx(HEATMAP.gamma[0])
    check(figures.objective_heatmap(grid, tmp_path / "new" / "map.png"), 9.0, 4.0)
    with pytest.raises(ValueError, match="size: is 1"):
        heatmap(1)
