"""Games of the stress set: derivatives against central differences, and nothing unlabelled."""

import numpy as np

from benchmarks.derivatives import row
from benchmarks.stress import families
from foresight_env.equilibrium import Status, solve_many

FAMILIES = {family.name: family for family in families()}


def test_derivatives_are_those_of_the_solution():
    found = row(FAMILIES["cars on lanes, elastic"], (2, 5), 6)
    assert found["compared"] >= 3
    assert found["within 1e-05"] == "100%", found


def test_failures_are_labelled_and_solutions_finite():
    family = FAMILIES["walkers, shared constraint"]
    random = np.random.default_rng(0)
    drawn = [family.draw(random, 2, k) for k in range(64)]
    found = solve_many(
        family.make(2, 5),
        np.stack([d.states.ravel() for d in drawn]),
        [d.theta for d in drawn],
        np.stack([d.gamma for d in drawn]),
    )
    solved = found.status == Status.SOLVED
    assert np.mean(solved | (found.status == Status.INFEASIBLE)) > 0.95
    assert np.isfinite(np.concatenate(found.states, axis=2)[solved]).all()
    assert (found.residual[solved] <= 1e-6).all()
    # Whoever starts so deep inside the margin that one step cannot leave it has no game to play.
    infeasible = [
        d.situation for d, s in zip(drawn, found.status, strict=True) if s == Status.INFEASIBLE
    ]
    assert set(infeasible) <= {"inside the margin"}
