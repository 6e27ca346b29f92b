"""Order in which trials are handed to processes, so that each program is compiled once.

Trials that need the same compiled programs form a group. The first of a group, its pilot, compiles
them into the cache that all processes share; the others wait for it, then load them. One pilot runs
at a time, since groups share programs, too: while it compiles, other processes run trials of groups
whose pilots have finished.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Sequence

from evaluation.execution.store import Trial


class Pilots:
    """Trials that may be run now, by group."""

    def __init__(self, trials: Sequence[Trial], programs: Sequence[str]) -> None:
        """`programs`: columns of a trial that decide which programs it needs."""
        self._programs = tuple(programs)
        self._groups: dict[Hashable, deque[Trial]] = {}
        for trial in trials:
            self._groups.setdefault(self._group(trial), deque()).append(trial)
        self._waiting = deque(self._groups)
        self._flying: Hashable | None = None
        """The group whose pilot is running."""

    def _group(self, trial: Trial) -> Hashable:
        return tuple(repr(trial[name]) for name in self._programs)

    def start(self) -> list[Trial]:
        """Return the first trials to hand out: one pilot."""
        return self._next_pilot()

    def finished(self, trial: Trial) -> list[Trial]:
        """Return the trials that the end of `trial` releases: none unless it was a pilot."""
        group = self._group(trial)
        if group != self._flying:
            return []
        released = [*self._groups.pop(group)]
        # The next pilot comes first: whoever is free compiles, the others run what is compiled.
        return [*self._next_pilot(), *released]

    def _next_pilot(self) -> list[Trial]:
        self._flying = self._waiting.popleft() if self._waiting else None
        return [] if self._flying is None else [self._groups[self._flying].popleft()]
