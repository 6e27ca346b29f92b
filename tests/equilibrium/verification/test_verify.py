"""`verify` distinguishes equilibria from first-order points; random crosswalks are all solved."""

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import SolverOptions, Status, shift, solve, verify
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of, split
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_theta,
    same_best_response,
)
from foresight_env.equilibrium.verification.verify import player_cost, restricted
from foresight_env.games import (
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    MinimumDistance,
    Player,
)
from foresight_env.scenarios.crosswalk import crosswalk_game, draw_crossing
from tests.support.small_games import CROSSING_STATES, crossing, crossing_theta


def test_random_crosswalks_are_solved_and_some_verified():
    game = crosswalk_game(2, 25, "soft")
    random = np.random.default_rng(2024)
    for k in range(20):
        drawn = draw_crossing(random, 2)
        found = solve(game, drawn.initial_state, drawn.theta, drawn.gamma)
        assert found.status == Status.SOLVED, k
        assert found.residual <= 1e-8
        if k < 5:
            checked = verify(game, found, drawn.theta, drawn.gamma)
            assert checked.is_local_equilibrium
            assert (checked.curvature > 0).all()
            assert np.abs(checked.gap).max() < 1e-6


def test_common_multipliers_are_each_players_own_share():
    """A multiplier in present values weighs less for whom the stage is far away."""
    game = crossing("hard", multiplier="common")
    found = solve(game, CROSSING_STATES, crossing_theta(), [0.95, 0.5])
    assert found.status == Status.SOLVED
    # The constraint is felt.
    assert split(layout_of(game), jnp.asarray(found.point.mult)).row.max() > 1e-2
    checked = verify(game, found, crossing_theta(), [0.95, 0.5])
    assert checked.is_local_equilibrium
    layout = layout_of(game)
    with jax.enable_x64(True):
        parameters = jax.tree.map(
            jnp.asarray, check_parameters(game, CROSSING_STATES, crossing_theta(), [0.95, 0.5])
        )
        for i in range(2):
            alone = layout_of(best_response_game(game, i))
            point = jax.tree.map(jnp.asarray, found.point)
            theta = best_response_theta(layout, i, parameters.theta, point.x, point.u)
            mine = Parameters(
                parameters.initial_state[layout.state_slices[i]],
                (theta,),
                parameters.gamma[i : i + 1],
            )
            own = restricted(layout, i, point, parameters)
            at = evaluate(alone, pairs_of(alone), own, mine, jnp.zeros(()), SolverOptions().barrier)
            assert at.error < 1e-7


@dataclass(frozen=True)
class NumberedEffort(Effort):
    """The same cost, of a class that promises nothing: each player is verified as another game."""

    def __call__(self, i, t, x, u, theta):
        return super().__call__(i, t, x, u, theta)


def test_identical_players_share_a_best_response_game():
    """In the first one's place each has its own costs, and what it sees in the joint game."""
    near = Inequality(MinimumDistance("closest"), 2, 2.0)
    one = Player(DoubleIntegrator(0.3), (Goal(), Effort(0.1)), inequalities=(near,), name="one")
    walkers = (one, replace(one, name="two"), replace(one, name="three"))
    game, random = Game(walkers, 3), np.random.default_rng(0)
    theta = tuple({"goal": random.normal(size=2), "closest": 0.2 + i} for i in range(3))
    (members,) = same_best_response(game, theta)
    assert members == range(3)
    numbered = [replace(p, costs=(Goal(), NumberedEffort(0.1))) for p in walkers]
    other = (one, replace(one, costs=(Goal(), Effort(0.2))), one)
    for others in (numbered, other):
        apart = same_best_response(Game(tuple(others), 3), theta)
        assert apart == tuple(range(i, i + 1) for i in range(3))
    unequal = (*theta[:2], {**theta[2], "more": 1.0})
    assert same_best_response(game, unequal) == (range(2), range(2, 3))
    layout, alone = layout_of(game), layout_of(best_response_game(game, 0))
    x, u = random.normal(size=(3, layout.n)), random.normal(size=(3, layout.m))
    with jax.enable_x64(True):
        together = Parameters(jnp.zeros(layout.n), theta, jnp.array([0.9, 0.7, 0.5]))
        for i in members:
            own = best_response_theta(layout, i, theta, jnp.asarray(x), jnp.asarray(u), place=0)
            mine = Parameters(jnp.zeros(4), (own,), together.gamma[i : i + 1])
            at = (jnp.asarray(x[:, layout.state_slices[i]]), u[:, layout.control_slices[i]])
            cost = player_cost(layout, i, jnp.asarray(x), jnp.asarray(u), together)
            assert player_cost(alone, 0, *map(jnp.asarray, at), mine) == pytest.approx(float(cost))


def test_a_head_on_stalemate_is_a_saddle():
    """On one line, symmetric: neither has a reason to step aside, and both would gain by it."""
    game, theta = crossing("reference"), crossing_theta(np.array([[1.0, 0.0], [0.0, 0.0]]), 20.0)
    initial_state = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    stalemate = solve(game, initial_state, theta, 0.95)
    assert stalemate.status == Status.SOLVED
    assert np.abs(np.stack(stalemate.states)[..., 1]).max() < 1e-9
    checked = verify(game, stalemate, theta, 0.95)
    assert not checked.is_local_equilibrium
    assert (checked.curvature < 0).all()


@dataclass(frozen=True)
class Ring:
    """Cheapest anywhere one metre from the origin, which is a hilltop."""

    def __call__(self, i, t, x, u, theta):
        return theta["height"] * (jnp.sum(x[i][:2] ** 2) - 1.0) ** 2


@lru_cache
def ring():
    return Game((Player(DoubleIntegrator(0.3), (Ring(), Effort(0.01))),), 6)


@pytest.mark.parametrize(("start", "expected"), [(0.0, False), (0.8, True)])
def test_a_maximiser_is_told_from_a_minimiser(start, expected):
    initial_state, theta = np.array([[start, 0.0, 0.0, 0.0]]), ({"height": 1.0},)
    found = solve(ring(), initial_state, theta, 0.9)
    assert found.status == Status.SOLVED
    checked = verify(ring(), found, theta, 0.9)
    assert bool(checked.is_local_equilibrium) is expected
    assert (checked.curvature[0] > 0) == expected


def test_a_plan_that_is_no_equilibrium_is_refused():
    initial_state, theta = np.array([[0.8, 0.0, 0.0, 0.0]]), ({"height": 1.0},)
    found = solve(ring(), initial_state, theta, 0.9)
    worse = found.point._replace(u=found.point.u + 0.5)
    checked = verify(ring(), found._replace(point=worse), theta, 0.9)
    assert not checked.is_local_equilibrium
    assert checked.gap[0] > 1e-3


def test_arguments_of_another_type_are_named():
    initial_state, theta = np.array([[0.8, 0.0, 0.0, 0.0]]), ({"height": 1.0},)
    found = solve(ring(), initial_state, theta, 0.9)
    with pytest.raises(ValueError, match=r"options: is \{'tolerance': 0.1\}, not made by calling"):
        verify(ring(), found, theta, 0.9, options={"tolerance": 0.1})
    with pytest.raises(ValueError, match="solution: is 3, not made by calling Solution"):
        verify(ring(), 3, theta, 0.9)
    with pytest.raises(ValueError, match="solution: is None, not made by calling Solution"):
        shift(None)


def test_an_unsolved_game_is_never_an_equilibrium():
    initial_state, theta = np.array([[0.8, 0.0, 0.0, 0.0]]), ({"height": 1.0},)
    found = solve(ring(), initial_state, theta, 0.9)
    failed = found._replace(status=np.asarray(int(Status.ITERATION_LIMIT)))
    assert not verify(ring(), failed, theta, 0.9).is_local_equilibrium


ON_ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from foresight_env.equilibrium import solve, verify
from tests.equilibrium.verification.test_verify import ring
initial_state, theta = np.array([[0.8, 0.0, 0.0, 0.0]]), ({"height": 1.0},)
assert verify(ring(), solve(ring(), initial_state, theta, 0.9), theta, 0.9).is_local_equilibrium
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity on this system")
def test_one_core_is_enough():
    """XLA compiles in another way there, and some LAPACK calls not at all (jaxlib 0.10)."""
    run = subprocess.run([sys.executable, "-c", ON_ONE_CORE], capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
