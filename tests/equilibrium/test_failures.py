"""What cannot be solved says so, and bad input is refused by name."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

from foresight_env.equilibrium import SolveError, Status, solve
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    Player,
    SharedInequality,
)

ORIGIN = np.zeros((1, 4))
GOAL = ({"goal": np.ones(2)},)


def beyond(i, t, x, u, theta):
    return x[i][:1] - 5.0


@lru_cache
def impossible():
    """Within a second of bounded acceleration nobody is 5 m ahead."""
    player = Player(
        DoubleIntegrator(0.2),
        (Goal(), Effort()),
        control_bounds=Bounds.box(-1, 1, 2),
        inequalities=(Inequality(beyond, 1),),
    )
    return Game((player,), 4)


def test_an_infeasible_game_is_labelled():
    found = solve(impossible(), ORIGIN, GOAL, 0.9)
    assert found.status == Status.INFEASIBLE
    assert found.residual > 1e-3


def test_throw_raises_with_the_remedy():
    with pytest.raises(SolveError, match=r"INFEASIBLE.*penalty") as caught:
        solve(impossible(), ORIGIN, GOAL, 0.9, throw=True)
    assert caught.value.status == Status.INFEASIBLE


def test_derivatives_of_a_failed_solve_are_nan():
    def reached(gamma):
        return jnp.sum(solve(impossible(), ORIGIN, GOAL, gamma).states[0][-1])

    with jax.enable_x64(True):
        slope = jax.grad(reached)(jnp.asarray(0.9))
    assert np.isnan(np.asarray(slope))


def test_traced_invalid_input_is_a_status_of_its_instance_alone():
    starts = np.stack([CROSSING_STATES, CROSSING_STATES, CROSSING_STATES])
    starts[1, 0, 0] = np.nan
    starts[2, 1, 2] = 3.0  # beyond the speed limit
    with jax.enable_x64(True):
        status = jax.vmap(
            lambda x0: solve(crossing("soft"), x0, crossing_theta(), CROSSING_GAMMA).status
        )(jnp.asarray(starts))
    expected = [Status.SOLVED, Status.INVALID_INPUT, Status.INVALID_INPUT]
    np.testing.assert_array_equal(np.asarray(status), expected)


def attempt(game=None, x0=CROSSING_STATES, theta=None, gamma=0.9, **more):
    solve(game or crossing("soft"), x0, theta or crossing_theta(), gamma, **more)


THETA = crossing_theta()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"x0": np.zeros((3, 4))}, "x0: has 3 states"),
        ({"x0": (np.zeros(4), np.zeros(3))}, r"x0\[1\]: has shape \(3,\)"),
        ({"x0": np.full((2, 4), np.nan)}, "x0: contains NaN"),
        ({"x0": [[0.0, 0.0, 2.0, 0.0], [1.0, 0.0, 0.0, 0.0]]}, r"x0\[0\]: entry 2 is 2"),
        ({"theta": THETA[:1]}, "theta: expected 2 mappings"),
        ({"theta": ({**THETA[0], "goal": np.full(2, np.inf)}, THETA[1])}, "theta: contains NaN"),
        ({"theta": ({**THETA[0], "goal": "left"}, THETA[1])}, r"theta\['goal'\]: is not numeric"),
        (
            {"theta": (THETA[0], {k: v for k, v in THETA[1].items() if k != "goal"})},
            r"players\[1\].costs\[0\] \(Goal\): theta has no entry 'goal'",
        ),
        (
            {"theta": (THETA[0], {k: v for k, v in THETA[1].items() if k != "price"})},
            r"players\[1\].inequalities\[0\]: theta has no entry 'price'",
        ),
        ({"gamma": np.ones(3)}, r"gamma: has shape \(3,\)"),
        ({"gamma": [0.9, np.nan]}, "gamma: contains NaN"),
        ({"gamma": [0.9, -0.1]}, "gamma.1.: is -0.1; .*takes 0 to inf"),
        ({"guess": (np.zeros((8, 2)), np.zeros((7, 2)))}, "guess: controls of shapes"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_bad_arguments_are_named(arguments, named):
    with pytest.raises(ValueError, match=named):
        attempt(**arguments)


def test_a_guess_for_another_horizon_is_refused():
    other = solve(crossing("soft", 1), CROSSING_STATES, THETA, 0.9)
    with pytest.raises(ValueError, match=r"guess: solves a game with joint states of shape \(1"):
        attempt(guess=other)


def vector_cost(i, t, x, u, theta):
    return x[i]


def broken_cost(i, t, x, u, theta):
    return jnp.sum(x[i] @ np.ones(3))


def two_rows(i, t, x, u, theta):
    return x[i][:2]


def one_shared_row(t, x, u, thetas):
    return x[0][:1]


class ShortState:
    state_size, control_size, linear = 4, 2, True

    def __call__(self, t, state, control):
        return state[:3]


@pytest.mark.parametrize(
    ("changes", "shared", "named"),
    [
        ({"costs": (Goal(), vector_cost)}, (), r"costs\[1\] \(vector_cost\): .*\(4,\).*a scalar"),
        ({"costs": (broken_cost,)}, (), r"costs\[0\] \(broken_cost\): cannot be evaluated"),
        (
            {"inequalities": (Inequality(two_rows, 1),)},
            (),
            r"inequalities\[0\] \(two_rows\): returns shape \(2,\); expected shape \(1,\)",
        ),
        ({}, (SharedInequality(one_shared_row, 2),), r"shared\[0\].*expected shape \(2,\)"),
        ({"dynamics": ShortState()}, (), r"players\[0\].dynamics.*\(3,\)"),
    ],
    ids=["vector cost", "broken cost", "inequality size", "shared size", "dynamics"],
)
def test_bad_functions_are_named(changes, shared, named):
    arguments = {"dynamics": DoubleIntegrator(0.1), "costs": (Goal(), Effort()), **changes}
    game = Game((Player(**arguments),), 3, shared)
    with pytest.raises(ValueError, match=named):
        attempt(game, ORIGIN, GOAL)
