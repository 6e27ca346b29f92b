"""When non-convex curvature is let in; no game goes in circles between with and without."""

import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import SolverOptions, Status, solve
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.convexification import next_weight, used_weight
from foresight_env.equilibrium.settings import Convexification
from foresight_env.games import Effort, Game, Goal, KinematicBicycle, Player
from foresight_env.scenarios.aachen import AACHEN
from foresight_env.scenarios.crosswalk import crosswalk_game
from foresight_env.scenarios.intersection import intersection_game, player_theta

BENT = layout_of(Game((Player(KinematicBicycle(0.1), (Goal(1.0), Effort(1.0))),), 2))
LINEAR = layout_of(crosswalk_game(2, 2))
SCHEDULE = Convexification()


def after(weight, before, now, taken, layout=BENT):
    return float(next_weight(SCHEDULE, layout, *map(jnp.asarray, (weight, before, now, taken))))


def used(weight, error, exact_below):
    return float(used_weight(SCHEDULE, jnp.asarray(weight), jnp.asarray(error), exact_below))


def test_steps_decide_how_much_is_left_out():
    assert after(0.5, 2.0, 1.9, 1.0) < 0.5  # closer, by a full step
    assert after(0.01, 2.0, 4.1, 1.0) > 0.1  # thrown back
    assert after(0.01, 2.0, 1.0, 0.3) > 0.1  # cut
    assert after(0.0, 2.0, 9.0, 1.0) > SCHEDULE.exact  # also from nothing
    assert after(0.5, 2.0, 2.1, 1.0) == 0.5
    assert after(0.5, 2.0, 1.0, 0.7) == 0.5
    assert after(1.0, 2.0, 9.0, 1.0) == 1.0  # never more than all
    assert after(1.0, 2.0, 1.0, 1.0, LINEAR) == 1.0


def test_near_a_solution_nothing_is_left_out():
    assert used(0.75, 0.02, 0.01) == 0.75
    assert used(0.7, 0.01, 0.01) == 0.0
    assert used(1.0, np.inf, np.inf) == 0.0  # the semismooth phase
    assert used(0.5 * SCHEDULE.exact, 5.0, 0.01) == 0.0


@pytest.mark.parametrize("gamma", [0.7, 1.0])
def test_a_turning_car_does_not_go_in_circles(gamma):
    """With a switch at a residual of 1 it was not there after 200 steps, at gamma = 1."""
    game = intersection_game(("car",), AACHEN.lanes[2:3])
    theta = [player_theta("car", AACHEN.goals[2])]
    once = SolverOptions(barrier_schedule=(0.1,))
    found = solve(game, AACHEN.initial_state[2:3], theta, gamma, options=once)
    assert int(found.status) == Status.SOLVED
