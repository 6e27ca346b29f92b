"""Egos by name, for the command line and the studies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agents.constant_velocity import ConstantVelocity
from agents.foresight import Foresight, farsighted
from agents.oracle import Oracle
from agents.policy import EgoPolicy

EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    "oracle": Oracle,
    "foresight": Foresight,
    "farsighted": farsighted,
    "constant-velocity": ConstantVelocity,
}


def make_ego(name: str) -> EgoPolicy[Any]:
    """The registered ego of that name; `ValueError` lists the names."""
    if name not in EGOS:
        raise ValueError(f"ego: {name!r} is unknown; choose from {', '.join(EGOS)}")
    return EGOS[name]()
