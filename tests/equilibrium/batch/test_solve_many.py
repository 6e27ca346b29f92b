"""`solve_many` is `solve` on every game, whatever the other games do."""

import subprocess
import sys

import jax
import numpy as np
import pytest

from foresight_env.equilibrium import SolverOptions, Status, shift, solve, solve_many
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_GOALS,
    CROSSING_STATES,
    UNEQUAL_STATES,
    UNEQUAL_THETA,
    crossing,
    crossing_theta,
    unequal_sizes,
)

COUNT = 11


def drawn(count=COUNT):
    random = np.random.default_rng(3)
    states = np.tile(CROSSING_STATES, (count, 1, 1))
    states[:, :, :2] += random.uniform(-0.2, 0.2, (count, 2, 2))
    return states, random.uniform(0.1, 1.0, (count, 2))


def same(found, k, one):
    assert found.status[k] == one.status
    assert found.iterations[k] == one.iterations
    for many, alone in zip(
        (*found.states, *found.controls), (*one.states, *one.controls), strict=True
    ):
        np.testing.assert_allclose(many[k], alone, atol=1e-9)


@pytest.mark.parametrize(("size", "threads"), [(None, 2), (4, 2), (32, 1)])
def test_every_game_is_what_solve_makes_of_it(size, threads):
    states, gamma = drawn()
    found = solve_many(
        crossing(), states, crossing_theta(), gamma, batch_size=size, threads=threads
    )
    assert (found.status == Status.SOLVED).all()
    assert len(set(found.iterations.tolist())) > 1  # some games take longer than others
    for k in range(COUNT):
        same(found, k, solve(crossing(), states[k], crossing_theta(), gamma[k]))


def test_games_that_fail_leave_the_others_alone():
    states, gamma = drawn(5)
    states[2] = [[0.5, 1.0, 0.0, 0.0], [0.5, 1.0, 0.0, 0.0]]  # on top of each other: infeasible
    found = solve_many(crossing("hard"), states, crossing_theta(), gamma, batch_size=2, threads=1)
    assert found.status.tolist() == [0, 0, int(Status.INFEASIBLE), 0, 0]
    same(found, 3, solve(crossing("hard"), states[3], crossing_theta(), gamma[3]))


def test_phases_are_those_of_solve():
    states, gamma = drawn(4)
    options = SolverOptions(linear_steps=6)
    found = solve_many(crossing(), states, crossing_theta(), gamma, batch_size=2, options=options)
    assert found.iterations.max() > 6
    for k in range(4):
        same(found, k, solve(crossing(), states[k], crossing_theta(), gamma[k], options=options))


def test_parameters_of_each_game_and_a_warm_start():
    states, gamma = drawn(3)
    thetas = [crossing_theta(CROSSING_GOALS + 0.05 * k) for k in range(3)]
    found = solve_many(crossing(), states, thetas, gamma, threads=1)
    again = solve_many(crossing(), states, thetas, gamma, initial_guess=found, threads=1)
    assert (again.status == Status.SOLVED).all()
    assert (again.iterations < found.iterations).all()
    for k in range(3):
        same(found, k, solve(crossing(), states[k], thetas[k], gamma[k]))
        np.testing.assert_allclose(again.states[0][k], found.states[0][k], atol=1e-7)


def test_semismooth_steps_that_lead_away_end_after_three():
    """From guesses that are other games' solutions; in a batch as alone."""
    states, gamma = drawn(8)
    states = np.tile(states, (2, 1, 1))
    states[8:, :, :2] += np.random.default_rng(1).normal(0.0, 0.6, (8, 2, 2))
    gamma = np.tile(gamma, (2, 1))
    begun = solve_many(crossing(), states, crossing_theta(), gamma)
    far = jax.tree.map(lambda v: np.roll(v, 5, axis=0), begun)
    found = solve_many(crossing(), states, crossing_theta(), gamma, initial_guess=far)
    assert (found.status == Status.SOLVED).all()
    ended = alike = 0
    for k in range(len(states)):
        initial_guess = jax.tree.map(lambda v, k=k: v[k], far)
        usual, three = (
            solve(
                crossing(),
                states[k],
                crossing_theta(),
                gamma[k],
                initial_guess=initial_guess,
                options=options,
            )
            for options in (SolverOptions(), SolverOptions(semismooth_steps=3))
        )
        alike += usual.iterations == found.iterations[k]
        ended += usual.iterations == three.iterations > SolverOptions().semismooth_steps
    assert 0 < ended < len(states)
    # Long ways are not the same to the last bit, nor then to the last step.
    assert alike > 0.5 * len(states)


CROWD = """
import numpy as np
from foresight_env.equilibrium import solve_many
from foresight_env.scenarios.crosswalk import crosswalk_game, draw_crossing
for count in (24, 2):
    drawn = [draw_crossing(np.random.default_rng(k), 6) for k in range(count)]
    found = solve_many(
        crosswalk_game(6, 5, "hard"), np.stack([d.initial_state for d in drawn]),
        [d.theta for d in drawn], np.stack([d.gamma for d in drawn]), threads=2,
    )
    assert (found.status == 0).all(), found.status
"""


def test_two_threads_do_not_wait_for_each_other():
    """LAPACK's batched calls from two threads would make jaxlib 0.10 hang."""
    subprocess.run([sys.executable, "-c", CROWD], check=True, timeout=240)


def test_players_of_unequal_sizes():
    states = [np.stack([s, s + 0.01]) for s in UNEQUAL_STATES]
    found = solve_many(unequal_sizes(), states, UNEQUAL_THETA, 0.9, threads=1)
    for k in range(2):
        one = solve(unequal_sizes(), [s[k] for s in states], UNEQUAL_THETA, 0.9)
        same(found, k, one)


def test_shift_refuses_a_batch():
    states, gamma = drawn(2)
    found = solve_many(crossing(), states, crossing_theta(), gamma, threads=1)
    with pytest.raises(ValueError, match="solution: holds 2 games"):
        shift(found)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"initial_state": np.zeros((0, 8))}, "initial_state: is empty"),
        ({"initial_state": np.zeros((3, 7))}, r"initial_state: has shape \(3, 7\)"),
        ({"gamma": np.ones((3, 2))}, r"gamma: has shape \(3, 2\)"),
        ({"gamma": [[0.5, 0.5], [0.5, -1.0]]}, r"game 1: gamma\[1\]: is -1"),
        ({"theta": [crossing_theta()]}, "theta: has 1 entries"),
        ({"initial_guess": "other"}, "initial_guess: solves another game: joint states have shape"),
    ],
)
def test_bad_arguments_are_named(change, told):
    arguments = {
        "initial_state": np.tile(CROSSING_STATES, (2, 1, 1)),
        "theta": crossing_theta(),
        "gamma": np.tile(CROSSING_GAMMA, (2, 1)),
        **change,
    }
    if "initial_guess" in arguments:
        arguments["initial_guess"] = solve_many(
            crossing(), np.tile(CROSSING_STATES, (3, 1, 1)), crossing_theta(), 0.9, threads=1
        )
    with pytest.raises(ValueError, match=told):
        solve_many(crossing(), **arguments)
