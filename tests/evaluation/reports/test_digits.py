"""Numbers for readers: significant digits, no exponents where they would only puzzle."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.reports.digits import significant


@pytest.mark.parametrize(
    ("value", "digits", "told"),
    [
        (1563.4, 3, "1563"),
        (120.4, 2, "120"),
        (352.1, 3, "352"),
        (30.06, 3, "30.1"),
        (5.72, 2, "5.7"),
        (0.0561, 2, "0.056"),
        (-41.2, 2, "-41"),
        (0.0, 2, "0"),
    ],
)
def test_digits_that_mean_something(value, digits, told):
    assert significant(value, digits) == told


@given(st.floats(1.0, 1e12), st.integers(1, 6))
def test_no_exponent_and_the_value_to_its_digits(value, digits):
    told = significant(value, digits)
    assert "e" not in told
    assert float(told) == pytest.approx(value, rel=0.5 * 10.0 ** (1 - digits) + 1e-12)
