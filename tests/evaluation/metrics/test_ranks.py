"""Ranks: exact where all is clear, wide where nothing is, and as sure as they say."""

import numpy as np
import pytest

from evaluation.metrics.ranks import LEAST_GROUPS, Rank, ranks


def test_what_is_clear_is_exact():
    values = np.array([[3.0], [1.0], [2.0]]) + 0.01 * np.arange(20)
    assert ranks(values, range(20)) == [Rank(3, 3, 3), Rank(1, 1, 1), Rank(2, 2, 2)]


def test_ties_share_a_place_and_stay_open():
    found = ranks(np.ones((3, 20)), range(20))
    assert found == [Rank(1, 1, 3)] * 3


def test_few_groups_say_nothing():
    values = np.array([[1.0], [2.0]]) + np.zeros(40)
    few = [k % (LEAST_GROUPS - 1) for k in range(40)]
    assert ranks(values, few) == [Rank(1, 1, 2), Rank(2, 1, 2)]
    assert ranks(values, [k % LEAST_GROUPS for k in range(40)])[0] == Rank(1, 1, 1)


def test_dependent_cases_make_it_less_sure():
    """Ten groups of twenty equal cases are ten cases."""
    random = np.random.default_rng(3)
    alone = random.normal([[0.0], [0.35]], 1.0, (2, 10))
    many = np.repeat(alone, 20, axis=1)
    by_case = ranks(many, range(200))
    by_group = ranks(many, [k // 20 for k in range(200)])
    assert by_group == ranks(alone, range(10))
    assert by_case[0].high - by_case[0].low < by_group[0].high - by_group[0].low


def test_the_true_place_is_covered():
    """Two are equally good and one is worse: the worst is last, the others share the first two."""
    covered = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        values = random.normal([[0.0], [0.0], [0.5]], 1.0, (3, 40))
        first, second, third = ranks(values, range(40))
        covered += first.low == 1 and first.high >= 2 and second.low == 1 and third.high == 3
    assert covered >= 0.93 * 200


def test_one_alone_is_first():
    assert ranks(np.arange(20.0)[None], range(20)) == [Rank(1, 1, 1)]


def test_missing_values_are_refused():
    with pytest.raises(ValueError, match="values: empty or with NaN"):
        ranks(np.array([[1.0, np.nan], [1.0, 2.0]]), range(2))
