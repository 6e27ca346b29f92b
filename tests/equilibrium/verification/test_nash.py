"""Nash equilibria: no player's cost falls when that player alone changes its controls."""

import numpy as np
import pytest

from foresight_env.equilibrium import Status, shift, solve
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_STATES,
    UNEQUAL_STATES,
    UNEQUAL_THETA,
    crossing,
    crossing_theta,
    unequal_sizes,
)

CLOSEST, PRICE, DT = 0.9, 2.0, 0.2


def double_integrator(state, control):
    position = state[:2] + DT * state[2:] + 0.5 * DT**2 * control
    return np.concatenate([position, state[2:] + DT * control])


def bicycle(state, control):
    _, _, v, psi = state
    rate = [v * np.cos(psi), v * np.sin(psi), control[0], v * np.tan(control[1])]
    return state + DT * np.array(rate)


def walker(state, control):
    return state + DT * control


def roll(motion, initial_state, controls):
    states = [np.asarray(initial_state)]
    for control in controls:
        states.append(motion(states[-1], control))
    return np.array(states)


def cost(kind, i, states, controls, goal, gamma):
    """The discounted cost written out; stage t charges u_t and x_{t+1}."""
    total = 0.0
    for t in range(1, len(controls) + 1):
        own, other = states[i][t][:2], states[1 - i][t][:2]
        gap = np.linalg.norm(own - other)
        stage = np.sum((own - goal) ** 2) + 0.1 * np.sum(controls[t - 1] ** 2)
        if kind == "soft":
            stage += PRICE * max(0.0, CLOSEST - gap**2)
        if kind == "unequal":
            stage += PRICE * max(0.0, 1.0 - gap) ** 2
        total += gamma**t * stage
        if kind == "reference":
            total += PRICE * max(0.0, CLOSEST - gap) ** 2
    return total


def case(kind):
    """Game, initial_state, theta, motions, control limits."""
    if kind == "unequal":
        limits = (np.array([2.0, 0.5]), np.array([np.inf, np.inf]))
        return unequal_sizes(), UNEQUAL_STATES, UNEQUAL_THETA, (bicycle, walker), limits
    theta = crossing_theta(price=PRICE)
    limits = (np.full(2, 2.0),) * 2
    return crossing(kind), CROSSING_STATES, theta, (double_integrator,) * 2, limits


def feasible(kind, i, states, controls, limit, slack=1e-9):
    ok = (np.abs(controls) <= limit + slack).all()
    if kind != "unequal":
        ok &= (np.abs(states[i][1:, 2:]) <= 0.9 + slack).all()
    if kind == "hard":
        gap = np.sum((states[0][1:, :2] - states[1][1:, :2]) ** 2, axis=1)
        ok &= (gap >= 0.6 - slack).all()
    return bool(ok)


def deviations(kind, found, gamma, random):
    """(rise of the deviator's cost, step) for every feasible one-sided change tried."""
    _, initial_state, theta, motions, limits = case(kind)
    rises = []
    for i in range(2):
        base = cost(kind, i, found.states, found.controls[i], theta[i]["goal"], gamma[i])
        for k in range(120):
            # Towards another plan that the (convex) bounds allow, or any way from here.
            plan = 0.4 * random.uniform(-1, 1, found.controls[i].shape)
            if k % 2:
                plan = found.controls[i] + plan
            for step in (0.2, 0.02, -0.02, -0.2):
                controls = found.controls[i] + step * (plan - found.controls[i])
                states = list(found.states)
                states[i] = roll(motions[i], initial_state[i], controls)
                if feasible(kind, i, states, controls, limits[i]):
                    new = cost(kind, i, states, controls, theta[i]["goal"], gamma[i])
                    rises.append((new - base, step))
    return np.array(rises)


@pytest.mark.parametrize("kind", ["soft", "reference", "hard", "unequal"])
def test_no_player_gains_by_deviating_alone(kind):
    game, initial_state, theta, motions, limits = case(kind)
    found = solve(game, initial_state, theta, CROSSING_GAMMA)
    assert found.status == Status.SOLVED
    for i in range(2):
        np.testing.assert_allclose(
            found.states[i], roll(motions[i], initial_state[i], found.controls[i]), atol=1e-7
        )
        assert feasible(kind, i, found.states, found.controls[i], limits[i], slack=1e-7)
    rises = deviations(kind, found, CROSSING_GAMMA, np.random.default_rng(0))
    assert len(rises) > 100
    assert (rises[:, 1] < 0).any()
    # Complementarity products of 1e-9 leave at most 1e-7 in total.
    assert rises[:, 0].min() > -1e-7


def test_the_deviation_test_rejects_what_is_no_equilibrium():
    game, initial_state, theta, _, _ = case("soft")
    found = solve(game, initial_state, theta, CROSSING_GAMMA)
    elsewhere = deviations("soft", found, np.array([0.3, 0.99]), np.random.default_rng(0))
    assert elsewhere[:, 0].min() < -1e-4


def test_individual_and_common_multipliers_choose_different_equilibria():
    """Both keep the distance; who gives way depends on how the price is shared."""
    found = {}
    for multiplier in ("individual", "common"):
        game = crossing("hard", multiplier=multiplier)
        for name, gamma in (("unequal", (1.0, 0.5)), ("equal", (0.8, 0.8))):
            result = solve(game, CROSSING_STATES, crossing_theta(), gamma)
            assert result.status == Status.SOLVED
            gap = np.sum((result.states[0] - result.states[1])[1:, :2] ** 2, axis=1)
            assert gap.min() == pytest.approx(0.6, abs=1e-6)
            found[multiplier, name] = np.concatenate(result.states, 1)
    unequal = found["individual", "unequal"] - found["common", "unequal"]
    assert np.abs(unequal).max() > 1e-2
    equal = found["individual", "equal"] - found["common", "equal"]
    assert np.abs(equal).max() < 1e-6


def test_a_warm_start_reaches_the_same_equilibrium_sooner():
    game, initial_state, theta, _, _ = case("soft")
    cold = solve(game, initial_state, theta, CROSSING_GAMMA)
    near = solve(game, initial_state, theta, CROSSING_GAMMA + 0.01)
    warm = solve(game, initial_state, theta, CROSSING_GAMMA, initial_guess=near)
    assert warm.status == Status.SOLVED
    assert warm.iterations < cold.iterations
    for a, b in zip(warm.states, cold.states, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_controls_as_a_guess_and_a_shifted_solution_reach_an_equilibrium():
    game, initial_state, theta, _, _ = case("soft")
    cold = solve(game, initial_state, theta, CROSSING_GAMMA)
    guided = solve(game, initial_state, theta, CROSSING_GAMMA, initial_guess=cold.controls)
    np.testing.assert_allclose(guided.states[0], cold.states[0], atol=1e-6)
    later = [s[1] for s in cold.states]
    fresh = solve(game, later, theta, CROSSING_GAMMA)
    moved = shift(cold)
    np.testing.assert_array_equal(moved.controls[0][:-1], cold.controls[0][1:])
    warm = solve(game, later, theta, CROSSING_GAMMA, initial_guess=moved)
    assert warm.status == Status.SOLVED
    np.testing.assert_allclose(warm.states[0], fresh.states[0], atol=1e-6)


def test_speed_and_control_limits_are_met_with_equality_where_they_bind():
    far = np.array([[9.0, 9.0], [-9.0, 9.0]])
    found = solve(crossing("soft"), CROSSING_STATES, crossing_theta(far), CROSSING_GAMMA)
    assert found.status == Status.SOLVED
    for x, u in zip(found.states, found.controls, strict=True):
        assert np.abs(x[1:, 2:]).max() == pytest.approx(0.9, abs=1e-6)
        assert np.abs(u).max() == pytest.approx(2.0, abs=1e-6)


def test_myopic_players_solve_one_stage_at_a_time():
    """gamma = 0: each stage's control minimises that stage's cost alone."""
    game, alone = crossing("soft"), crossing("soft", 1)
    theta = crossing_theta()
    states = [CROSSING_STATES]
    for _ in range(game.horizon):
        stage = solve(alone, states[-1], theta, 1.0)
        assert stage.status == Status.SOLVED
        states.append(np.stack([s[1] for s in stage.states]))
    stagewise = np.stack(states, axis=1)
    limit = solve(game, CROSSING_STATES, theta, 0.0)
    near = solve(game, CROSSING_STATES, theta, 1e-3)
    assert limit.status == near.status == Status.SOLVED
    np.testing.assert_allclose(np.stack(limit.states), stagewise, atol=1e-6)
    np.testing.assert_allclose(np.stack(near.states), stagewise, atol=5e-3)
    assert np.abs(np.stack(near.states) - stagewise).max() > 1e-6


def test_players_with_gamma_above_1():
    found = solve(crossing("soft"), CROSSING_STATES, crossing_theta(), 1.1)
    assert found.status == Status.SOLVED
    rises = deviations("soft", found, np.array([1.1, 1.1]), np.random.default_rng(1))
    assert rises[:, 0].min() > -1e-7
