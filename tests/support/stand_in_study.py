"""A small study with trials that cost nothing, run by other processes.

`python -m tests.support.stand_in_study FOLDER WORKERS SECONDS`; WORKERS: a number or a scheduler.
"""

import signal
import sys
import time

from evaluation.execution.runner import run_trials
from evaluation.execution.store import Store

KEY = ("ego", "seed")
EGOS = ("a", "b")
SEEDS = 12


def trial(ego, seed, seconds):
    """A row that depends on the trial only; one trial in six fails."""
    time.sleep(seconds)
    if seed % 6 == 5:
        raise ArithmeticError(f"no luck with {seed}")
    return {"value": seed / 7.0 + len(ego), "list": [float(seed)] * (seed % 3), "flag": seed > 3}


def study(folder, workers=0, seconds=0.0, seeds=SEEDS):
    """All trials that are not there yet."""
    store = Store(folder, "stand-in", {"seeds": SEEDS}, KEY)
    trials = [{"ego": e, "seed": s, "seconds": seconds} for s in range(seeds) for e in EGOS]
    return run_trials(trial, trials, store, workers=workers, label="stand-in", chunk=3)


if __name__ == "__main__":
    # What starts it may ignore interrupts (a shell does for its background jobs).
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # As other processes import it: there `__main__` is something else.
    from tests.support import stand_in_study

    workers = int(sys.argv[2]) if sys.argv[2].isdigit() else sys.argv[2]
    stand_in_study.study(sys.argv[1], workers, float(sys.argv[3]))
