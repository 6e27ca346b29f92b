"""How a `Solution` prints: short, with what is to be checked before use."""

import jax
import numpy as np

from foresight_env.equilibrium import Status, solve, solve_many
from tests.support.small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

SHORT = 200


def test_a_solution_prints_its_status_in_a_line():
    found = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
    told = str(found)
    assert "SOLVED" in told
    assert f"iterations={int(found.iterations)}" in told
    assert len(told) < SHORT
    assert "\n" not in told
    failed = found._replace(status=np.asarray(int(Status.DIVERGED)))
    assert "DIVERGED" in str(failed)


def test_many_solutions_print_how_many_were_solved():
    states = np.tile(CROSSING_STATES, (5, 1, 1))
    found = solve_many(crossing(), states, crossing_theta(), CROSSING_GAMMA, threads=1)
    failed = found._replace(status=np.array([0, 0, int(Status.DIVERGED), 0, 0]))
    assert "5 of 5 solved" in str(found)
    assert "4 of 5 solved" in str(failed)
    assert len(str(failed)) < SHORT


def test_a_traced_solution_prints_without_its_values():
    told = []

    @jax.jit
    def residual(gamma):
        found = solve(crossing(), CROSSING_STATES, crossing_theta(), gamma)
        told.append(str(found))
        return found.residual

    residual(CROSSING_GAMMA)
    assert told[0].startswith("Solution(")
    assert len(told[0]) < SHORT
