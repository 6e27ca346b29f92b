"""Numbers of the paper and its reference implementation, and the same of our results.

The reference's numbers are means over all noise levels of the raw results that it publishes (those
of the intersection: without noise), the paper's are its statements; `docs/measurements.md`
discusses the differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from evaluation.execution.store import Results, Row
from evaluation.reports.digits import significant
from evaluation.reports.naming import label_of
from evaluation.rollout.endings import COLLISION, REACHED
from evaluation.studies.estimation import LEAST_STD, bound

METHODS = ("assume-gamma-1", "infer-gamma")
"""In the order of the reference's numbers."""
Select = dict[str, Any]
"""Columns and the values that rows must have in them."""


@dataclass(frozen=True)
class PublishedNumber:
    """A published number, and how it is computed from the rows of a study."""

    what: str
    reference: str
    """Of the reference implementation; empty where it says nothing."""
    paper: str
    here: Callable[[Sequence[Row]], str]
    """Empty where the rows have no such number."""


def _chosen(rows: Sequence[Row], select: Select) -> list[Row]:
    return [r for r in rows if not r["error"] and all(r[k] == v for k, v in select.items())]


def _error(select: Select, rows: Sequence[Row]) -> str:
    """Mean over what was selected, all noise levels."""
    errors = [r["error_squared"] for r in _chosen(rows, select)]
    if not errors:
        return ""
    return significant(float(np.mean(errors)), 3)


def _error_without_noise(select: Select, rows: Sequence[Row]) -> str:
    return _error({**select, "std": 0.0}, rows)


def _saved(rows: Sequence[Row]) -> str:
    """How much smaller the error is of infer-gamma: mean over observations and noise."""
    settings = {(r["observation"], r["std"]) for r in rows}
    saved = []
    for observation, std in settings:
        mine = {"observation": observation, "std": std}
        inferred, assumed = (
            [r["error_squared"] for r in _chosen(rows, {**mine, "method": m})]
            for m in ("infer-gamma", "assume-gamma-1")
        )
        if inferred and assumed:
            saved.append(1.0 - np.mean(inferred) / np.mean(assumed))
    return f"{100.0 * np.mean(saved):.0f} %" if saved else ""


def _above_bound(observation: str, rows: Sequence[Row]) -> str:
    """Mean error over the Cramer-Rao bound: median and worst of the noise levels."""
    mine = _chosen(rows, {"observation": observation, "method": "infer-gamma"})
    levels = sorted({r["std"] for r in mine if r["std"] > LEAST_STD})
    ratios = [
        np.mean([r["error_squared"] for r in mine if r["std"] == std])
        / (bound(observation) * std**2)
        for std in levels
    ]
    return f"{np.median(ratios):.2f}, at worst {max(ratios):.2f}" if ratios else ""


def _left_turn(ego: str, tell: Callable[[list[Row]], str], rows: Sequence[Row]) -> str:
    """Among game agents / among IDM cars."""
    text = [
        tell(mine)
        for others in ("receding", "idm")
        if (mine := _chosen(rows, {"scene": "left_turn", "others": others, "ego": ego}))
    ]
    return " / ".join(text)


def _ends(ending: str, mine: list[Row]) -> str:
    return f"{sum(r['ended'] == ending for r in mine)} of {len(mine)}"


def _least_distance(mine: list[Row]) -> str:
    return f"{min(r['min_distance'] for r in mine):.2f} m"


def _both(
    what: str,
    observation: str,
    reference: tuple[str, str],
    find: Callable[[Select, Sequence[Row]], str],
) -> tuple[PublishedNumber, ...]:
    """A number of both methods."""
    return tuple(
        PublishedNumber(
            f"{what}, {label_of(method)}",
            value,
            "",
            partial(find, {"observation": observation, "method": method}),
        )
        for method, value in zip(METHODS, reference, strict=True)
    )


PUBLISHED: dict[str, tuple[PublishedNumber, ...]] = {
    "estimation": (
        *_both("mean error from full states", "full", ("0.608", "0.176"), _error),
        *_both("mean error from positions", "positions", ("2.189", "0.273"), _error),
        *(
            PublishedNumber(
                f"error over the Cramer-Rao bound, {text}",
                reference,
                "",
                partial(_above_bound, seen),
            )
            for text, seen, reference in (
                ("full states", "full", "up to 100"),
                ("positions", "positions", ""),
            )
        ),
    ),
    "intersection": (
        *_both("error without noise, full states", "full", ("56.9", "45.4"), _error_without_noise),
        *_both(
            "error without noise, positions", "positions", ("55.9", "15.2"), _error_without_noise
        ),
        PublishedNumber("error saved by inferring gamma", "33 %", "33 %", _saved),
    ),
    "driving": (
        PublishedNumber(
            "left turn, infer-gamma: nearest to another car's middle",
            "",
            "above 6 m",
            partial(_left_turn, "infer-gamma", _least_distance),
        ),
        PublishedNumber(
            "left turn, infer-gamma: goal reached",
            "",
            "50 of 50",
            partial(_left_turn, "infer-gamma", partial(_ends, REACHED)),
        ),
        PublishedNumber(
            "left turn, infer-gamma: collisions",
            "",
            "0 of 50",
            partial(_left_turn, "infer-gamma", partial(_ends, COLLISION)),
        ),
    ),
}
"""By a study's name."""


def compared(results: Results) -> list[tuple[str, str, str, str]]:
    """The quantity, the reference's number, the paper's, and that of these results."""
    return [
        (c.what, c.reference, c.paper, c.here(results.rows))
        for c in PUBLISHED.get(results.study, ())
    ]
