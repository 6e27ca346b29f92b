"""Counts of calls, failures and violations during rough use."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Random = np.random.Generator


@dataclass
class Tally:
    """Counts by what was used: its kind, or `kind: variant`."""

    done: Counter[str] = field(default_factory=Counter)
    episodes: Counter[str] = field(default_factory=Counter)
    """Whole episodes of an environment, by its id."""
    refused: Counter[str] = field(default_factory=Counter)
    failed: Counter[str] = field(default_factory=Counter)
    """Failures that a status reports."""
    violations: list[str] = field(default_factory=list)

    def must_refuse(self, name: str, case: str, call: Callable[[], Any]) -> None:
        """Call what is wrong: only `ValueError` is right."""
        try:
            call()
        except ValueError:
            self.refused[name] += 1
        except Exception as error:
            self.violations.append(f"{name}: {case}: {type(error).__name__}: {error}")
        else:
            self.violations.append(f"{name}: {case} was accepted")

    def must_be_finite(self, name: str, case: str, *values: Any) -> None:
        """Nothing in these arrays may be NaN or infinite."""
        for value in values:
            if not np.isfinite(np.asarray(value, float)).all():
                self.violations.append(f"{name}: {case}: {value}")
