"""Trials are handed out so that each program is compiled by one process."""

import random

from hypothesis import given
from hypothesis import strategies as st

from evaluation.execution.local import results
from evaluation.execution.pilots import Pilots
from evaluation.execution.trial import Attempt
from tests.support import stand_in_study as stand_in


def trials_of(groups):
    return [
        {"ego": e, "seed": s} for s in range(max(groups)) for e, n in enumerate(groups) if s < n
    ]


@given(st.lists(st.integers(1, 5), min_size=1, max_size=5), st.integers(1, 4), st.randoms())
def test_a_group_waits_for_its_pilot_and_one_pilot_runs_at_a_time(groups, workers, order):
    """A pool of `workers` that finishes what it runs in any order."""
    trials = trials_of(groups)
    pilots, seen, compiled = Pilots(trials, ("ego",)), [], set()
    queue = list(pilots.next_pilot())
    running = []
    while queue or running:
        while queue and len(running) < workers:
            running.append(queue.pop(0))
        piloting = [t for t in running if t["ego"] not in compiled]
        assert len({t["ego"] for t in piloting}) == len(piloting) <= 1
        done = running.pop(order.randrange(len(running)))
        compiled.add(done["ego"])
        seen.append(done)
        queue += pilots.finished(done)
    assert sorted(map(str, seen)) == sorted(map(str, trials))


def test_processes_return_the_rows_of_this_one():
    trials = [{"ego": e, "seed": s, "seconds": 0.0} for s in range(6) for e in ("a", "b")]
    random.Random(0).shuffle(trials)
    attempt = Attempt(stand_in.trial, stand_in.KEY)
    found = list(results(attempt, trials, 2, ("ego",)))
    assert sorted(map(str, found)) == sorted(str(attempt(t)) for t in trials)


def test_idle_processes_run_further_pilots():
    trials = [{"ego": e, "seed": 0} for e in range(4)]
    pilots = Pilots(trials, ("ego",))
    (first,) = pilots.next_pilot()
    assert pilots.finished(first) == [trials[1]]
    assert pilots.next_pilot() == [trials[2]]
    assert pilots.finished(trials[1]) == []  # another one is running
    assert pilots.finished(trials[2]) == [trials[3]]
    assert pilots.next_pilot() == []
