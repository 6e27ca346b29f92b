"""Games of the stress set: derivatives against central differences, and nothing unlabelled."""

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.derivatives import row
from benchmarks.stress import families, proven_infeasible
from foresight_env.equilibrium import Status, solve_many

FAMILIES = {family.name: family for family in families()}


def test_derivatives_are_those_of_the_solution():
    found = row(FAMILIES["cars on lanes, elastic"], (2, 5), 6)
    assert found["compared"] >= 3
    assert found["within 1e-05"] == "100%", found


@pytest.mark.parametrize("name", ["walkers, shared constraint", "cars, shared constraint"])
def test_no_control_escapes_a_proof_that_there_is_no_solution(name):
    """Within bounds, however two agents act, some pair is too close after the first step."""
    game, family = FAMILIES[name].make(2, 5), FAMILIES[name]
    random = np.random.default_rng(3)
    answers = []
    for k in range(40):
        drawn = family.draw(random, 2, k)
        proven = proven_infeasible(game, drawn)
        answers.append(proven)
        threshold = game.shared[0].function.threshold
        farthest = 0.0
        for _ in range(60 if proven else 0):
            ends = []
            for player, state in zip(game.players, drawn.states, strict=True):
                least, most = player.control_bounds.lower[0], player.control_bounds.upper[0]
                control = random.choice([least, most]) if _ % 2 else random.uniform(least, most)
                after = np.asarray(player.dynamics(1, jnp.asarray(state), jnp.asarray(control)))
                low, high = player.state_bounds.lower[0], player.state_bounds.upper[0]
                allowed = ((after >= low) & (after <= high)).all()
                ends.append(after[:2] if allowed else np.full(2, np.nan))
            farthest = np.fmax(farthest, np.sum((ends[0] - ends[1]) ** 2))
        assert farthest < threshold
    assert 0 < sum(answers) < len(answers)


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
    # A game that starts so deep inside the margin that one step cannot leave it has no solution.
    infeasible = [
        d.arrangement for d, s in zip(drawn, found.status, strict=True) if s == Status.INFEASIBLE
    ]
    assert set(infeasible) <= {"inside the margin"}
