"""Intervals of means and shares: repeatable, of the right width, with the nominal coverage."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.metrics.statistics import (
    clustered_interval,
    exact_mcnemar,
    mean_and_error,
    mean_interval,
    ratio_interval,
    share_interval,
    stratified_interval,
)

FINITE = st.floats(-1e3, 1e3)


@settings(max_examples=30)
@given(st.lists(FINITE, min_size=1, max_size=20))
def test_the_interval_holds_the_mean(values):
    found = mean_interval(np.array(values))
    assert found.mean == pytest.approx(np.mean(values))
    slack = 1e-9 * max(1.0, abs(found.mean))
    assert min(values) - slack <= found.low <= found.mean + slack
    assert found.mean - slack <= found.high <= max(values) + slack


def test_degenerate_samples():
    assert mean_interval(np.array([2.0])) == (2.0, 2.0, 2.0)
    assert mean_interval(np.full(7, 3.5)) == (3.5, 3.5, 3.5)
    for values in ([], [1.0, np.nan]):
        with pytest.raises(ValueError, match="values: empty or with NaN"):
            mean_interval(np.array(values))


def test_intervals_are_repeatable_and_of_the_right_width():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    found = mean_interval(values)
    assert found == mean_interval(values)
    # Normal theory: +- 1.96 * 2 / sqrt(400) = 0.196.
    assert 0.30 < found.high - found.low < 0.49


def test_the_interval_covers_the_true_mean():
    random = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        found = mean_interval(random.exponential(1.0, 40))
        held += found.low <= 1.0 <= found.high
    assert 0.86 < held / 200 < 0.99  # 95 % nominal, the percentile interval is a little short


def test_shares_by_hand():
    """Wilson's interval of 2 in 10: (0.0567, 0.5098)."""
    found = share_interval(np.arange(10) < 2)
    assert found == pytest.approx((0.2, 0.0567, 0.5098), abs=1e-4)
    assert share_interval(np.zeros(6, bool)).high == pytest.approx(0.3903, abs=1e-4)
    with pytest.raises(ValueError, match="outcomes: is empty"):
        share_interval(np.zeros(0, bool))


def test_standard_errors():
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    mean, error = mean_and_error(values)
    assert mean == pytest.approx(values.mean())
    assert error == pytest.approx(2.0 / np.sqrt(400), rel=0.1)
    assert mean_and_error(np.array([4.0])) == (4.0, 0.0)
    with pytest.raises(ValueError, match="values"):
        mean_and_error(np.array([]))


def test_mcnemar_counts_the_pairs_that_differ():
    yes, no = True, False
    first = np.array([yes] * 12 + [no] * 3 + [yes] * 20 + [no] * 5)
    second = np.array([no] * 12 + [yes] * 3 + [yes] * 20 + [no] * 5)
    # Binomial tail of 15 fair coins: (C(15,0) + C(15,1) + C(15,2) + C(15,3)) / 2^15, both sides.
    assert exact_mcnemar(first, second) == pytest.approx(2 * (1 + 15 + 105 + 455) / 2**15)
    assert exact_mcnemar(second, first) == pytest.approx(exact_mcnemar(first, second))
    assert exact_mcnemar(first, first) == 1.0


def test_the_ratio_of_means_of_pairs():
    random = np.random.default_rng(0)
    bottom = random.uniform(1.0, 3.0, 200)
    top = 0.4 * bottom + random.normal(0.0, 0.2, 200)
    found = ratio_interval(top, bottom)
    assert found.mean == pytest.approx(top.sum() / bottom.sum())
    assert found.low < 0.4 < found.high
    assert 0.02 < found.high - found.low < 0.04  # 2 * 1.96 * 0.2 / 2 / sqrt(200)
    assert ratio_interval(2.0 * bottom, bottom) == pytest.approx((2.0, 2.0, 2.0))
    # Resamples of the zero alone have no ratio.
    assert ratio_interval(np.array([0.0, 1.0]), np.array([0.0, 2.0])) == (0.5, 0.5, 0.5)
    for top, bottom in (([np.nan], [1.0]), ([], []), ([1.0, 1.0], [1.0, -1.0])):
        with pytest.raises(ValueError, match="numerators, denominators"):
            ratio_interval(np.array(top), np.array(bottom))


def test_strata_weigh_the_same():
    """Of 4 values around 1 and 100 around 3 the mean is 2, and the small stratum decides."""
    random = np.random.default_rng(0)
    small, large = random.normal(1.0, 1.0, 4), random.normal(3.0, 1.0, 100)
    small, large = small - small.mean() + 1.0, large - large.mean() + 3.0
    found = stratified_interval([small, large], [range(4), range(100)])
    assert found.mean == pytest.approx(2.0)
    alone = clustered_interval(small, range(4))
    assert found.high - found.low == pytest.approx(0.5 * (alone.high - alone.low), rel=0.15)
    assert stratified_interval([small], [range(4)]) == alone
    # Values that move together within a stratum's clusters: fewer independent ones.
    shared = np.repeat(small, 25)
    wide = stratified_interval([shared], [np.repeat(range(4), 25).tolist()])
    narrow = stratified_interval([shared], [range(100)])
    assert wide.high - wide.low > 3.0 * (narrow.high - narrow.low)
