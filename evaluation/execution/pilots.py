"""Order in which trials are handed to processes, so that each program is compiled once.

Trials that need the same compiled programs form a group. The first of a group, its pilot, compiles
them into the cache that all processes share; the others wait for it, then load them. One pilot runs
at a time, since groups share programs, too: while it compiles, other processes run trials of groups
whose pilots have finished. Once the first pilot has finished, a process that would have nothing to
do runs another pilot all the same.
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
        self._flying: set[Hashable] = set()
        """Groups whose pilots are running."""

    def _group(self, trial: Trial) -> Hashable:
        return tuple(repr(trial[name]) for name in self._programs)

    def next_pilot(self) -> list[Trial]:
        """Return the next pilot, to be run; nothing where all have been."""
        if not self._waiting:
            return []
        group = self._waiting.popleft()
        self._flying.add(group)
        return [self._groups[group].popleft()]

    def finished(self, trial: Trial) -> list[Trial]:
        """Return the trials that the end of `trial` releases: none unless it was a pilot."""
        group = self._group(trial)
        if group not in self._flying:
            return []
        self._flying.remove(group)
        released = [*self._groups.pop(group)]
        # The next pilot comes first: one process compiles, the others run what is compiled.
        return [*([] if self._flying else self.next_pilot()), *released]
