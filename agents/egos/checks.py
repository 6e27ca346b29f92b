"""Checks of what a user hands to an ego policy, before anything is computed."""

from __future__ import annotations

from typing import Any


def check_memory(memory: Any, kind: type) -> None:
    """Raise `ValueError` where a policy is given something else than its memory."""
    if not isinstance(memory, kind):
        raise ValueError(
            f"memory: is {memory!r:.80}; expected the {kind.__name__} that this policy's init, "
            "update or act returned"
        )
