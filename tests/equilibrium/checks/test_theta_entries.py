"""Misspelt entries of `theta` are refused; what costs read or players declare is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import solve, solve_many
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_parameters,
)
from foresight_env.games import (
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    MinimumDistance,
    Player,
    SharedInequality,
    SigmoidProximity,
    full_state,
)
from foresight_env.inverse import estimate
from foresight_env.scenarios import crosswalk, driving, encounter, intersection
from tests.support.small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

GOAL = np.ones(2)


def squared(x, i, goal):
    return jnp.sum((x[i][:2] - goal) ** 2)


def indexed(i, t, x, u, theta):
    return squared(x, i, theta["goal"])


def by_default(i, t, x, u, theta):
    return squared(x, i, theta["goal"]) * theta.get("weight", 1.0)


def conditional(i, t, x, u, theta):
    return squared(x, i, theta["goal"]) + ("far" in theta)


def check(cost, theta, **player):
    game = Game((Player(DoubleIntegrator(0.2), (cost, Effort()), **player),), 4)
    return check_parameters(game, np.zeros((1, 4)), (theta,), 0.9)


@pytest.mark.parametrize("entry", ["gaol", "goal_weigth", "sped"])
def test_a_misspelt_entry_is_named_with_the_nearest_that_is_read(entry):
    theta = {"goal": GOAL, "goal_weight": 1.0, "speed": 1.0, entry: GOAL}

    def cost(i, t, x, u, theta):
        return theta["goal_weight"] * squared(x, i, theta["goal"]) * theta["speed"]

    near = {"gaol": "goal", "goal_weigth": "goal_weight", "sped": "speed"}[entry]
    with pytest.raises(
        ValueError, match=rf"theta\[0\].*'{entry}'.*'{near}'.*'goal', 'goal_weight'"
    ):
        check(cost, theta)


def test_every_solver_refuses_it():
    theta = tuple({**own, "gaol": GOAL} for own in crossing_theta())
    arguments = crossing(), CROSSING_STATES, theta, CROSSING_GAMMA
    with pytest.raises(ValueError, match=r"theta\[0\].*'gaol'"):
        solve(*arguments)
    with pytest.raises(ValueError, match=r"theta\[0\].*'gaol'"):
        solve_many(crossing(), CROSSING_STATES[None], theta, CROSSING_GAMMA)
    with pytest.raises(ValueError, match=r"theta\[0\].*'gaol'"):
        estimate(
            crossing(),
            np.zeros((4, 8)),
            full_state((4, 4)),
            initial_state=CROSSING_STATES,
            theta=theta,
            gamma=0.9,
        )
    second = (crossing_theta()[0], theta[1])
    with pytest.raises(ValueError, match=r"theta\[1\].*'gaol'"):
        jax.jit(lambda gamma: solve(crossing(), CROSSING_STATES, second, gamma).residual)(0.9)


@pytest.mark.parametrize(
    ("cost", "theta"),
    [
        (indexed, {"goal": GOAL}),
        (by_default, {"goal": GOAL, "weight": 2.0}),
        (by_default, {"goal": GOAL}),
        (conditional, {"goal": GOAL, "far": 1.0}),
        (Goal("goal_weight"), {"goal": GOAL, "goal_weight": 1.0}),
        # Fields that hold a name count as read, whatever the other players are.
        (SigmoidProximity("distance", "weight"), {"distance": 1.0, "weight": 1.0}),
    ],
)
def test_what_is_read_is_accepted(cost, theta):
    check(cost, theta)
    with pytest.raises(ValueError, match="'other'"):
        check(cost, {**theta, "other": 1.0})


@jax.jit
def compiled(position, theta):
    return jnp.sum((position - theta["goal"]) ** 2)


WHOLE = {
    "leaves": lambda i, t, x, u, theta: sum(squared(x, i, v) for v in jax.tree.leaves(theta)),
    "map": lambda i, t, x, u, theta: squared(x, i, jax.tree.map(lambda v: v + 1, theta)["goal"]),
    "copy": lambda i, t, x, u, theta: squared(x, i, dict(theta)["goal"]),
    "merged": lambda i, t, x, u, theta: squared(x, i, {**theta, "a": 1.0}["goal"]),
    "union": lambda i, t, x, u, theta: squared(x, i, (theta | {"a": 1.0})["goal"]),
    "keywords": lambda i, t, x, u, theta: (lambda goal, other: squared(x, i, goal))(**theta),
    "items": lambda i, t, x, u, theta: sum(squared(x, i, v) for _, v in theta.items()),
    "compiled": lambda i, t, x, u, theta: compiled(x[i][:2], theta),
}


@pytest.mark.parametrize("name", WHOLE)
def test_who_takes_all_of_theta_reads_all_of_it(name):
    check(WHOLE[name], {"goal": GOAL, "other": GOAL})


def test_where_reading_cannot_be_recorded_everything_is_accepted():
    def particular(i, t, x, u, theta):
        assert type(theta) is dict
        return squared(x, i, theta["goal"])

    check(particular, {"goal": GOAL, "gaol": GOAL})


def test_costs_are_given_the_same_mapping_as_ever_when_solved():
    kinds = set()

    def cost(i, t, x, u, theta):
        kinds.add(type(theta))
        return squared(x, i, theta["goal"])

    game = Game((Player(DoubleIntegrator(0.2), (cost, Effort()), extra_theta=("other",)),), 3)
    check_parameters(game, np.zeros((1, 4)), ({"goal": GOAL, "other": 1.0},), 0.9)
    assert kinds == {dict, *kinds}
    kinds.clear()
    solve(game, np.zeros((1, 4)), ({"goal": GOAL, "other": 1.0},), 0.9)
    assert kinds == {dict}


def test_entries_for_others_are_declared():
    theta = {"goal": GOAL, "color": 1.0}
    with pytest.raises(ValueError, match="extra_theta"):
        check(indexed, theta)
    check(indexed, theta, extra_theta=("color", "unused"))
    with pytest.raises(ValueError, match="extra_theta"):
        Player(DoubleIntegrator(0.2), (indexed,), extra_theta="color")
    with pytest.raises(ValueError, match=r"extra_theta\[0\]"):
        Player(DoubleIntegrator(0.2), (indexed,), extra_theta=(1,))


def test_constraints_penalties_and_shared_constraints_read_too():
    def near(i, t, x, u, theta):
        return theta["reach"] - x[i][0]

    def apart(t, x, u, thetas):
        return squared(x, 0, x[1][:2]) - thetas[1]["gap"]

    player = Player(
        DoubleIntegrator(0.2),
        (indexed, Effort()),
        inequalities=(Inequality(near, 1, "price"), Inequality(MinimumDistance("limit"), 1)),
    )
    game = Game((player, player), 4, (SharedInequality(apart, 1),))
    own = {"goal": GOAL, "reach": 5.0, "price": 1.0, "limit": 0.1}
    states = np.array([[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
    check_parameters(game, states, (own, {**own, "gap": 0.1}), 0.9)
    with pytest.raises(ValueError, match=r"theta\[0\].*'gap'"):
        check_parameters(game, states, ({**own, "gap": 0.1}, {**own, "gap": 0.1}), 0.9)


def test_a_wrong_shape_is_named_with_the_entry():
    with pytest.raises(ValueError, match=r"costs\[0\].*theta\[0\]\['goal'\] of shape \(3,\)"):
        check(Goal(), {"goal": np.zeros(3)})


SCENARIOS = {
    **{
        f"crosswalk {players} {proximity}": (
            crosswalk.crosswalk_game(players, 3, proximity),
            crosswalk.player_theta(GOAL),
        )
        for players in (1, 2)
        for proximity in ("soft", "hard", "reference")
    },
    **{
        f"driving {cars}": (
            driving.driving_game(cars, 3),
            driving.player_theta(np.zeros((5, 4)), 8.0, GOAL),
        )
        for cars in (1, 2)
    },
    **{
        f"intersection {kinds}": (
            intersection.intersection_game((kind,), (None,), horizon=3),
            intersection.player_theta(kind, GOAL),
        )
        for kinds, kind in (("walker", "pedestrian"), ("car", "car"))
    },
    **{
        f"encounter {kind}": (
            encounter.encounter_game((kind,), 3, 0.4),
            encounter.player_theta(kind, GOAL),
        )
        for kind in ("pedestrian", "car")
    },
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_take_what_their_player_theta_makes_and_nothing_else(name):
    game, own = SCENARIOS[name]
    count = len(game.players)
    states = np.zeros((count, 4)) + 3.0 * np.arange(count)[:, None] * [1.0, 0.0, 0.0, 0.0]
    check_parameters(game, states, (own,) * count, 0.9)
    with pytest.raises(ValueError, match=r"theta\[0\].*'goal_wieght'"):
        check_parameters(game, states, ({**own, "goal_wieght": 1.0},) * count, 0.9)


def test_best_responses_take_their_own_parameters():
    game = crossing("hard")
    alone = best_response_game(game, 0)
    others = {1: np.tile(CROSSING_STATES[1], (game.horizon, 1))}
    theta = best_response_parameters(game, 0, crossing_theta()[0], others)
    check_parameters(alone, [CROSSING_STATES[0]], (theta,), 0.9)
