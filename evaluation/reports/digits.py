"""Numbers for readers."""

from __future__ import annotations


def significant(value: float, digits: int) -> str:
    """`value` with so many significant digits, and without an exponent where it is large."""
    return f"{value:.0f}" if abs(value) >= 10.0 ** (digits - 1) else f"{value:.{digits}g}"
