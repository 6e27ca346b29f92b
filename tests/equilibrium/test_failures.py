"""Failures have a status, and bad input is refused by name."""

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import (
    Budget,
    SolveError,
    SolverOptions,
    Status,
    shift,
    solve,
    solve_many,
    verify,
)
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.newton.schedule import phase_count, phase_rules
from foresight_env.equilibrium.newton.start import begin, begin_phase
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Equality,
    Game,
    Goal,
    Inequality,
    Player,
    SharedInequality,
)
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting
from tests.support.small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

ORIGIN = np.zeros((1, 4))
GOAL = ({"goal": np.ones(2)},)


def beyond(i, t, x, u, theta):
    return x[i][:1] - 5.0


@lru_cache
def impossible():
    """Within a second of bounded acceleration no player is 5 m ahead."""
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
            lambda initial_state: (
                solve(crossing("soft"), initial_state, crossing_theta(), CROSSING_GAMMA).status
            )
        )(jnp.asarray(starts))
    expected = [Status.SOLVED, Status.INVALID_INPUT, Status.INVALID_INPUT]
    np.testing.assert_array_equal(np.asarray(status), expected)


def attempt(game=None, initial_state=CROSSING_STATES, theta=None, gamma=0.9, **more):
    solve(game or crossing("soft"), initial_state, theta or crossing_theta(), gamma, **more)


THETA = crossing_theta()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"initial_state": np.zeros((3, 4))}, "initial_state: has 3 states"),
        ({"initial_state": (np.zeros(4), np.zeros(3))}, r"initial_state\[1\]: has shape \(3,\)"),
        ({"initial_state": np.full((2, 4), np.nan)}, "initial_state: contains NaN"),
        (
            {"initial_state": [[0.0, 0.0, 2.0, 0.0], [1.0, 0.0, 0.0, 0.0]]},
            r"initial_state\[0\]: entry 2 is 2",
        ),
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
        (
            {"initial_guess": (np.zeros((8, 2)), np.zeros((7, 2)))},
            "initial_guess: controls of shapes",
        ),
        ({"initial_guess": 3}, "initial_guess: is 3; expected a Solution"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_bad_arguments_are_named(arguments, named):
    with pytest.raises(ValueError, match=named):
        attempt(**arguments)


def test_a_guess_for_another_horizon_is_refused():
    other = solve(crossing("soft", 1), CROSSING_STATES, THETA, 0.9)
    with pytest.raises(
        ValueError, match=r"initial_guess: solves another game: joint states have shape \(1"
    ):
        attempt(initial_guess=other)


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


def last_stage_capped():
    """A speed limit that holds after the last stage only."""
    free = np.full((6, 4), np.inf)
    high = free.copy()
    high[-1, 2] = 0.1
    player = Player(
        DoubleIntegrator(0.2), (Goal(), Effort(0.1)), state_bounds=Bounds.box(-free, high, 4)
    )
    return Game((player,), 6)


def test_a_shifted_guess_leaves_no_multiplier_where_there_is_no_bound():
    game, initial_state, theta = (
        last_stage_capped(),
        np.zeros((1, 4)),
        ({"goal": np.array([2.0, 0.0])},),
    )
    found = solve(game, initial_state, theta, 0.95)
    again = solve(game, initial_state, theta, 0.95, initial_guess=shift(found))
    assert found.status == again.status == Status.SOLVED
    np.testing.assert_allclose(again.controls[0], found.controls[0], atol=1e-7)


def divided(i, t, x, u, theta):
    return jnp.sum(u[i] ** 2) / theta["divisor"]


def distance(i, t, x, u, theta):
    return jnp.linalg.norm(u[i])  # no derivative where no player acts


def logarithm(i, t, x, u, theta):
    return jnp.reshape(jnp.log(x[i][0] - 1.0), (1,))


def root(i, t, x, u, theta):
    return jnp.sum(jnp.abs(u[i] - 1.0 * (t == 2)) ** 1.5)  # its curvature at 0 is infinite


@dataclass(frozen=True)
class Overflowing(DoubleIntegrator):
    def __call__(self, t, state, control):
        return super().__call__(t, state, control) / (t - 3)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"costs": (divided,)}, r"costs\[0\] \(divided\): its value is not finite at stage 1"),
        (
            {"costs": (Goal(), distance)},
            r"costs\[1\] \(distance\): its first derivative .* stage 1 .*small constant",
        ),
        ({"costs": (root,)}, r"costs\[0\] \(root\): its second derivative is not finite"),
        (
            {"inequalities": (Inequality(logarithm, 1),)},
            r"players\[0\].inequalities\[0\] \(logarithm\): its value",
        ),
        (
            {"dynamics": Overflowing(0.2)},
            r"players\[0\].dynamics \(Overflowing\): its value is not finite at stage 3",
        ),
    ],
    ids=["value", "first derivative", "second derivative", "constraint", "dynamics"],
)
def test_functions_that_are_not_finite_at_the_start_are_named(changes, named):
    arguments = {"dynamics": DoubleIntegrator(0.2), "costs": (Goal(), Effort()), **changes}
    arguments["extra_theta"] = ("divisor", "goal")
    game = Game((Player(**arguments),), 4)
    theta = ({"divisor": 0.0, "goal": np.array([1.0, 0.0])},)
    with pytest.raises(ValueError, match=named):
        solve(game, np.zeros((1, 4)), theta, 0.9)


def test_starts_that_are_not_finite_end_in_batches_too():
    game = Game((Player(DoubleIntegrator(0.2), (divided,)),), 3)
    many = solve_many(game, np.zeros((2, 4)), ({"divisor": 0.0},), 0.9)
    assert (many.status == Status.DIVERGED).all()


def test_a_guess_that_is_not_finite_is_refused():
    game, theta = Game((Player(DoubleIntegrator(0.2), (Goal(), Effort())),), 3), GOAL
    with pytest.raises(ValueError, match="initial_guess: contains NaN or infinity"):
        solve(game, np.zeros((1, 4)), theta, 0.9, initial_guess=(np.full((3, 2), np.nan),))


def roomy(i, t, x, u, theta):
    return jnp.reshape(10.0 - x[i][0], (1,))


def test_unused_penalties_do_not_make_a_game_infeasible():
    """Too few steps are an iteration limit, however high the price of what is not violated."""
    player = Player(
        DoubleIntegrator(0.2), (Goal(), Effort(0.1)), inequalities=(Inequality(roomy, 1, 1e4),)
    )
    few = SolverOptions(linear_steps=2, barrier_schedule=(1.0,))
    theta = ({"goal": np.array([2.0, 0.0])},)
    found = solve(Game((player,), 4), np.zeros((1, 4)), theta, 0.9, options=few)
    assert found.status == Status.ITERATION_LIMIT


@pytest.mark.parametrize("products", [(), (0.0,), (1.0, -1.0)])
def test_start_barriers_are_checked(products):
    with pytest.raises(ValueError, match="barrier_schedule: is"):
        SolverOptions(barrier_schedule=products)


def test_each_phase_begins_with_its_own_product():
    game, theta = last_stage_capped(), ({"goal": np.array([2.0, 0.0])},)
    options = SolverOptions(barrier_schedule=(1.0, 50.0, 0.2))
    layout = layout_of(game)
    with jax.enable_x64(True):
        parameters = check_parameters(game, np.zeros((1, 4)), theta, 0.9)
        exists = pairs_of(layout).exists
        for number, product in enumerate(options.barrier_schedule, 1):
            start = begin(layout, options, parameters, None)
            point = begin_phase(layout, options, parameters, start, jnp.asarray(number))
            products = np.asarray(point.slack * point.mult)[np.asarray(exists)]
            np.testing.assert_allclose(products, product)


def test_a_discarded_solution_is_not_used_again():
    """The first two are the solution's own; later ones begin at perturbed zeros."""
    game, theta = last_stage_capped(), ({"goal": np.array([2.0, 0.0])},)
    options = SolverOptions(barrier_schedule=(1.0, 50.0, 0.2))
    layout, found = layout_of(game), solve(game, np.zeros((1, 4)), theta, 0.9)
    with jax.enable_x64(True):
        parameters = check_parameters(game, np.ones((1, 4)), theta, 0.9)
        exists = np.asarray(pairs_of(layout).exists)
        point = jax.tree.map(jnp.asarray, found.point)
        warm, cold = (begin(layout, options, parameters, s) for s in (point, None))
        expected = {2: (50.0, point.u), 3: (1.0, 0.0), 4: (50.0, 0.0), 5: (0.2, 0.0)}
        assert phase_count(options, warm.warm, None) == max(expected)
        for number, (product, controls) in expected.items():
            start = begin_phase(layout, options, parameters, warm, jnp.asarray(number))
            np.testing.assert_allclose(np.asarray(start.slack * start.mult)[exists], product)
            assert 0.0 < np.abs(start.u - controls).max() <= 0.5 * (number - 1)
        for after, fresh in ((3, 1), (4, 2), (5, 3)):
            rules = (
                phase_rules(layout, options, jnp.asarray(number), start.warm, None)[:2]
                for number, start in ((after, warm), (fresh, cold))
            )
            assert [float(v) for v in next(rules)] == [float(v) for v in next(rules)]


def stubborn_crossing():
    """A game that is not solved from the last plan, and its arguments and that plan."""
    game, setting = crosswalk_game(2, 25), nominal_setting(2)
    places = np.array([[1.86737916, 1.84715993], [-0.01921973, 2.02985794]])
    states, initial_guess = list(np.pad(places, ((0, 0), (0, 2)))), None
    for _ in range(3):
        found = solve(game, states, setting.theta, [0.95, 0.9], initial_guess=initial_guess)
        assert found.status == Status.SOLVED
        initial_guess, states = shift(found), [s[1] for s in found.states]
    return game, (states, setting.theta, np.array([0.95, 0.9])), initial_guess


def test_a_solution_that_leads_nowhere_does_not_cost_a_game_that_can_be_solved():
    game, arguments, initial_guess = stubborn_crossing()
    found = solve(game, *arguments, initial_guess=initial_guess)
    assert found.status == Status.SOLVED
    assert found.iterations > SolverOptions().warm_steps


def test_a_limited_solve_ends_soon_with_a_status():
    game, arguments, initial_guess = stubborn_crossing()
    budget = Budget(phases=1, newton_steps=8)
    most = SolverOptions().semismooth_steps + budget.newton_steps
    found = solve(game, *arguments, initial_guess=initial_guess, budget=budget)
    assert found.status == Status.ITERATION_LIMIT
    assert budget.newton_steps <= found.iterations <= most
    traced = jax.jit(lambda *a: solve(game, *a, initial_guess=initial_guess, budget=budget))
    again = traced(*arguments)
    assert again.status == Status.ITERATION_LIMIT
    assert again.iterations == found.iterations
    cold = solve(game, *arguments, budget=budget)
    assert cold.status == Status.ITERATION_LIMIT
    assert cold.iterations == budget.newton_steps
    with pytest.raises(SolveError):
        solve(game, *arguments, initial_guess=initial_guess, budget=budget, throw=True)


def test_a_limited_solve_that_is_quick_is_the_same():
    setting = nominal_setting(2)
    game, arguments = crosswalk_game(2, 25), (setting.initial_state, setting.theta, [0.9, 0.9])
    initial_guess = solve(game, *arguments[:2], [0.95, 0.9])
    found = solve(game, *arguments, initial_guess=initial_guess)
    limited = solve(game, *arguments, initial_guess=initial_guess, budget=Budget.trial())
    assert found.status == limited.status == Status.SOLVED
    np.testing.assert_array_equal(np.concatenate(found.states), np.concatenate(limited.states))


def test_phases_are_counted_without_the_semismooth_one():
    game, arguments, initial_guess = stubborn_crossing()
    steps = [
        int(solve(game, *arguments, initial_guess=initial_guess, budget=Budget(n, 8)).iterations)
        for n in (1, 2, 3)
    ]
    assert np.diff(steps).tolist() == [8, 8]


@pytest.mark.parametrize("name", ["phases", "newton_steps", "trial_newton_steps", "fits"])
def test_budgets_without_room_are_refused(name):
    with pytest.raises(ValueError, match=rf"budget\.{name}: is 0; expected at least 1"):
        Budget(**{name: 0})


def test_a_guess_with_other_constraints_is_refused():
    game, theta = last_stage_capped(), ({"goal": np.array([2.0, 0.0])},)
    found = solve(game, np.zeros((1, 4)), theta, 0.95)
    own = game.players[0]
    fenced = replace(game, players=(replace(own, inequalities=(Inequality(roomy, 1),)),))
    with pytest.raises(ValueError, match="initial_guess: solves another game: slacks have shape"):
        solve(fenced, np.zeros((1, 4)), theta, 0.95, initial_guess=found)


@pytest.mark.parametrize(
    ("name", "value"),
    [("options", {}), ("options", SolverOptions), ("budget", 3), ("budget", {}), ("game", None)],
)
def test_settings_of_another_kind_are_named(name, value):
    arguments = {"game": crossing(), **{name: value}}
    with pytest.raises(ValueError, match=f"{name}: is .* not made by calling"):
        solve(
            initial_state=CROSSING_STATES,
            theta=crossing_theta(),
            gamma=CROSSING_GAMMA,
            **arguments,
        )


@pytest.mark.parametrize(
    ("name", "value"), [("options", {}), ("game", None), ("initial_guess", np.zeros(3))]
)
def test_settings_of_another_kind_are_named_for_many(name, value):
    arguments = {"game": crossing(), **{name: value}}
    with pytest.raises(ValueError, match=f"{name}: is .* not made by calling"):
        solve_many(
            initial_state=CROSSING_STATES[None],
            theta=crossing_theta(),
            gamma=CROSSING_GAMMA,
            **arguments,
        )


def below(i, t, x, u, theta):
    return 0.5 - x[i][0]


def below_row(i, t, x, u, theta):
    return below(i, t, x, u, theta)[None]


def along(i, t, x, u, theta):
    return u[i][0] - 2.0 * u[i][1]


def along_row(i, t, x, u, theta):
    return along(i, t, x, u, theta)[None]


def apart(t, x, u, thetas):
    return 0.9 - x[0][1]


def apart_row(t, x, u, thetas):
    return apart(t, x, u, thetas)[None]


@lru_cache
def one_row(scalar):
    """An own inequality, elastic and hard, an equality and a shared row, each active."""
    own, equal, shared = (below, along, apart) if scalar else (below_row, along_row, apart_row)
    player = Player(
        DoubleIntegrator(0.2),
        (Goal(), Effort()),
        inequalities=(Inequality(own, 1, 0.3),),
        equalities=(Equality(equal, 1),),
    )
    return Game((player,), 6, (SharedInequality(shared, 1),))


def test_a_scalar_is_one_row():
    found, rows = (solve(one_row(scalar), ORIGIN, GOAL, 0.9) for scalar in (True, False))
    assert found.status == Status.SOLVED
    for scalar, row in zip(found.point, rows.point, strict=True):
        np.testing.assert_array_equal(scalar, row)
    assert verify(one_row(True), found, GOAL, 0.9).is_local_equilibrium


def test_a_scalar_is_not_two_rows():
    player = Player(DoubleIntegrator(0.2), (Goal(),), inequalities=(Inequality(below, 2),))
    with pytest.raises(ValueError, match=r"inequalities\[0\] \(below\): returns shape \(\)"):
        solve(Game((player,), 3), ORIGIN, GOAL, 0.9)
