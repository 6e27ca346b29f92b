"""What the paper and its reference implementation reached, beside which reports put results.

Numbers are the means over all noise levels of the raw results that the reference implementation
publishes with it, and statements of the paper (`docs/results.md` discusses the differences).
"""

from __future__ import annotations

PUBLISHED: dict[str, tuple[tuple[str, str, str], ...]] = {
    "estimation": (
        ("mean error, full states", "gamma = 1: 0.608, gamma inferred: 0.176", "reference"),
        ("mean error, positions", "gamma = 1: 2.189, gamma inferred: 0.273", "reference"),
    ),
    "intersection": (
        ("error without noise, full states", "gamma = 1: 56.9, gamma inferred: 45.4", "reference"),
        ("error without noise, positions", "gamma = 1: 55.9, gamma inferred: 15.2", "reference"),
        ("error saved by inferring gamma", "33 % on average", "paper"),
    ),
    "driving": (
        ("left turn: distance to other cars", "always above 6 m, 50 of 50 trials", "paper"),
        ("left turn: goal reached", "50 of 50 trials", "paper"),
    ),
}
"""By a study's name: what is measured, the value, and whose it is."""
