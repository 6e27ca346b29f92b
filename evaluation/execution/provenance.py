"""Settings that make another agent of the same name, whose rows are kept separately."""

from __future__ import annotations

import hashlib
import inspect
import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

OURS = ("agents", "foresight_env")
"""Packages whose code is part of `code_digest`."""


def fingerprint(agent: Any) -> str:
    """An agent's settings as JSON; of one that is not this library's, its source's digest as well.

    Files that a user's agent reads, such as weights, do not count: give another name to what they
    make, or choose a fresh folder.
    """
    return json.dumps(agent, default=_described, sort_keys=True)


def _described(thing: Any) -> Any:
    if isinstance(thing, np.ndarray | np.generic):
        return thing.tolist()
    kind = type(thing)
    found: dict[str, Any] = {"class": kind.__qualname__}
    if is_dataclass(thing):
        found |= {f.name: getattr(thing, f.name) for f in fields(thing)}
    if kind.__module__.partition(".")[0] not in OURS:
        try:
            source = inspect.getsourcefile(thing if inspect.isroutine(thing) else kind)
        except TypeError:
            source = None  # a built-in has no source
        if source is not None and Path(source).is_file():
            found["source"] = hashlib.sha256(Path(source).read_bytes()).hexdigest()[:16]
    return found
