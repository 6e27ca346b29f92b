"""Annotations that run-time type checkers leave alone."""

from __future__ import annotations

import typing
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T", bound=Callable[..., Any])


def no_type_check(checked: T) -> T:
    """Exclude a class or function that checks its own arguments from run-time type checks.

    `typing` has a decorator of the same name, but static checkers skip what that one marks.
    """
    marked: T = typing.no_type_check(checked)
    return marked
