"""Games: checks, sizes, equality and hashing; observation models; what a stage costs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Equality,
    Game,
    Goal,
    Inequality,
    KinematicBicycle,
    MinimumDistance,
    ObservationModel,
    Player,
    SharedInequality,
    SharedMinimumDistance,
    SquaredDistanceHinge,
    full_state,
    positions,
    stage_cost,
)


def player(**changes):
    return Player(DoubleIntegrator(0.1), (Goal(), Effort()), **changes)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Game((), 3), "players: "),
        (lambda: Game((player(),), 0), "horizon: is 0"),
        (
            lambda: Game((player(), player(state_bounds=Bounds.box(0, 1, 3))), 3),
            r"players\[1\].state_bounds: has shape \(1, 3\); expected \(1, 4\) or \(3, 4\)",
        ),
        (
            lambda: Game((player(control_bounds=Bounds.box(np.zeros((2, 2)), 1, 2)),), 3),
            r"players\[0\].control_bounds: has shape \(2, 2\)",
        ),
        (
            lambda: Game(
                (player(), player()),
                3,
                (SharedInequality(SharedMinimumDistance(1.0), 1, players=(0, 2)),),
            ),
            r"shared\[0\].players: names player 2",
        ),
    ],
)
def test_bad_games_name_the_argument(make, named):
    with pytest.raises(ValueError, match=named):
        make()


def test_sizes_come_from_the_dynamics():
    class Unicycle:
        state_size, control_size, linear = 3, 2, False

        def __call__(self, t, state, control):
            return state

    game = Game((player(), Player(Unicycle(), (Effort(),))), 4)
    assert game.state_sizes == (4, 3)
    assert game.control_sizes == (2, 2)


def test_equal_games_are_equal_and_hash_alike():
    def make(weight):
        shared = (SharedInequality(SharedMinimumDistance(weight), 1, "common"),)
        bounded = player(
            control_bounds=Bounds.box(-1, 1, 2),
            inequalities=(Inequality(MinimumDistance("limit"), 1, 5.0),),
        )
        return Game((bounded, player()), 5, shared)

    assert make(1.0) == make(1.0)
    assert hash(make(1.0)) == hash(make(1.0))
    assert make(1.0) != make(2.0)
    assert len({make(1.0), make(1.0), make(2.0)}) == 2


def test_dynamics_of_equal_parameters_are_equal():
    assert DoubleIntegrator(0.1) == DoubleIntegrator(0.1)
    assert KinematicBicycle(0.1, 2.0) != KinematicBicycle(0.1, 2.5)


STATES = (np.arange(4.0), np.arange(10.0, 13.0))


def observed(model):
    with jax.enable_x64(True):
        return np.asarray(model(tuple(map(jnp.asarray, STATES))))


def test_full_state_sees_everything_and_knows_whose():
    model = full_state((4, 3))
    np.testing.assert_array_equal(observed(model), [0, 1, 2, 3, 10, 11, 12])
    assert model.owners == (0, 0, 0, 0, 1, 1, 1)
    assert model.size == 7


def test_positions_sees_the_first_two_entries():
    model = positions((4, 3))
    np.testing.assert_array_equal(observed(model), [0, 1, 10, 11])
    assert model.owners == (0, 0, 1, 1)
    assert model.size == 4


def test_a_users_observation_model():
    model = ObservationModel(lambda x: jnp.stack([jnp.sum((x[0][:2] - x[1][:2]) ** 2)]), (None,))
    np.testing.assert_array_equal(observed(model), [200.0])
    assert model.size == 1


def test_observation_models_are_hashable_by_value():
    assert full_state((4, 4)) == full_state((4, 4))
    assert hash(positions((4, 4))) == hash(positions((4, 4)))
    assert full_state((4, 4)) != positions((4, 4))


def test_stage_cost_splits_discounted_and_undiscounted_and_prices_violations():
    hinge = SquaredDistanceHinge(1.2, 2.0)
    near = player(
        undiscounted_costs=(hinge,), inequalities=(Inequality(MinimumDistance(1.2), 1, "price"),)
    )
    game = Game((near, player()), 3)
    x = (np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.5, 0.0, 0.0, 0.0]))
    u = (np.array([1.0, 2.0]), np.zeros(2))
    theta = {"goal": np.array([1.0, 0.0]), "price": np.array(4.0)}
    with jax.enable_x64(True):
        x, u = tuple(map(jnp.asarray, x)), tuple(map(jnp.asarray, u))
        discounted, flat = stage_cost(game, 0, 1, x, u, theta)
    assert float(discounted) == pytest.approx(1.0 + 0.1 * 5.0 + 4.0 * (1.2 - 0.25))
    assert float(flat) == pytest.approx(2.0 * 0.7**2)


def test_stage_cost_charges_nothing_for_a_constraint_that_holds_or_is_hard():
    hard = player(
        inequalities=(Inequality(MinimumDistance(1.2), 1), Inequality(MinimumDistance(0.1), 1, 3.0))
    )
    game = Game((hard, player()), 3)
    with jax.enable_x64(True):
        x = (jnp.zeros(4), jnp.array([0.5, 0.0, 0.0, 0.0]))
        u = (jnp.zeros(2), jnp.zeros(2))
        discounted, flat = stage_cost(game, 0, 1, x, u, {"goal": jnp.zeros(2)})
    assert float(discounted) == 0.0
    assert float(flat) == 0.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"costs": (Goal(), 1.0)}, r"costs\[1\]: is 1.0"),
        ({"costs": (Goal,)}, r"costs\[0\]: is <class"),
        ({"costs": Goal()}, "costs: is a Goal"),
        ({"undiscounted_costs": ("near",)}, r"undiscounted_costs\[0\]: is 'near'"),
        ({"inequalities": (MinimumDistance(1.0),)}, r"inequalities\[0\]: .*expected Inequality"),
        ({"equalities": (Inequality(MinimumDistance(1.0), 1),)}, r"equalities\[0\]: .*Equality"),
        ({"dynamics": 3}, "dynamics: is 3"),
        ({"dynamics": DoubleIntegrator}, "dynamics: is <class"),
        ({"dynamics": Goal()}, "dynamics: is Goal"),
        ({"discounting": 0.9}, "discounting: is 0.9"),
        ({"state_bounds": (0.0, 1.0)}, r"state_bounds: is \(0.0, 1.0\)"),
        ({"control_bounds": 1.0}, "control_bounds: is 1.0"),
    ],
)
def test_parts_of_a_player_of_the_wrong_kind_are_named(changes, named):
    with pytest.raises(ValueError, match=named):
        Player(**{"dynamics": DoubleIntegrator(0.1), "costs": (Goal(),), **changes})


def test_parts_of_a_game_of_the_wrong_kind_are_named():
    with pytest.raises(ValueError, match=r"players\[1\]: is DoubleIntegrator"):
        Game((player(), DoubleIntegrator(0.1)), 3)
    with pytest.raises(ValueError, match=r"shared\[0\]: is SharedMinimumDistance"):
        Game((player(), player()), 3, (SharedMinimumDistance(1.0),))


@pytest.mark.parametrize("kind", [Inequality, Equality, SharedInequality])
def test_constraints_need_a_function_and_a_size(kind):
    with pytest.raises(ValueError, match=r"function: is 1\.0"):
        kind(1.0, 1)
    for size in (0, True, 1.5):
        with pytest.raises(ValueError, match=f"size: is {size}"):
            kind(MinimumDistance(1.0), size)
