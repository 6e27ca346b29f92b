"""`python -m benchmarks.compilation KIND ...`: seconds that a first call takes beyond a second one.

Kinds: `solve PROXIMITY HORIZON`, `estimate OBSERVATION`. A process of its own, so that nothing is
compiled yet.
"""

from __future__ import annotations

import json
import sys

from benchmarks.timing import seconds_of
from evaluation.studies import estimation
from foresight_env.equilibrium import solve
from foresight_env.scenarios.crosswalk import MONTE_CARLO, Proximity, crosswalk_game

SEQUENCE_STD = 0.03
"""Noise of the sequence that the estimate is made from, m and m/s."""


def compile_solve(proximity: Proximity, horizon: int) -> float:
    """Of the forward solver."""
    game, setting = crosswalk_game(2, horizon, proximity), MONTE_CARLO

    def once() -> None:
        solve(game, setting.initial_state, setting.theta, setting.gamma)

    return seconds_of(once) - seconds_of(once)


def compile_estimate(observation: str) -> float:
    """Of the estimator; the forward solve that makes the observations comes before."""
    estimation.truth("soft")

    def once() -> None:
        estimation.fit(observation, SEQUENCE_STD, 0, "infer-gamma")

    return seconds_of(once) - seconds_of(once)


def main(arguments: list[str]) -> None:
    """Print the seconds as JSON."""
    kind, *rest = arguments
    if kind == "solve":
        proximity: Proximity = rest[0]  # type: ignore[assignment]
        seconds = compile_solve(proximity, int(rest[1]))
    else:
        seconds = compile_estimate(rest[0])
    print(json.dumps(seconds))


if __name__ == "__main__":
    main(sys.argv[1:])
