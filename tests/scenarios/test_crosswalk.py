"""The crosswalk by its definition: parameters, variants, limits, settings and draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import stage_cost
from foresight_env.scenarios.crosswalk import (
    COLLISION_DISTANCE,
    HEATMAP,
    MONTE_CARLO,
    SPEED_LIMIT,
    Ranges,
    crosswalk_game,
    draw_crossing,
    nominal_setting,
    player_theta,
)

X = (np.array([0.0, 0.0, 0.2, 0.0]), np.array([0.9, 0.0, 0.0, 0.1]))
U = (np.array([1.0, -2.0]), np.zeros(2))
GOAL = np.array([1.0, 2.0])


def paid(game, theta, t=1):
    """Player 0's discounted and undiscounted costs of one stage."""
    with jax.enable_x64(True):
        x, u = (tuple(map(jnp.asarray, v)) for v in (X, U))
        return tuple(float(v) for v in stage_cost(game, 0, t, x, u, theta))


def test_costs_are_the_papers():
    theta = player_theta(GOAL, goal_weight=2.0, control_weight=0.3, collision_weight=7.0)
    apart = 2.0 * 5.0 + 0.3 * 5.0
    soft = apart + 7.0 * (1.2 - 0.81)  # squared distance and threshold, as in equation 6
    assert paid(crosswalk_game(2, 5), theta) == pytest.approx((soft, 0.0))
    assert paid(crosswalk_game(2, 5, "hard"), theta) == pytest.approx((apart, 0.0))
    reference = crosswalk_game(2, 5, "reference")
    assert paid(reference, theta) == pytest.approx((apart, 7.0 * (1.2 - 0.9) ** 2))
    assert paid(reference, theta, t=5) == pytest.approx((apart, 0.0))  # of x_2..x_T


def test_hard_walkers_keep_apart_by_a_shared_constraint():
    game = crosswalk_game(3, 5, "hard")
    (shared,) = game.shared
    assert shared.size == 3
    x = tuple(map(jnp.asarray, (*X, np.array([0.0, 3.0, 0.0, 0.0]))))
    gaps = shared.function(1, x, (), ())
    np.testing.assert_allclose(gaps, [0.81 - 1.2, 9.0 - 1.2, 9.81 - 1.2], rtol=1e-6)
    assert not any(player.inequalities for player in game.players)


def test_limits_and_step():
    game = crosswalk_game(2, 7, dt=0.2)
    assert (game.horizon, game.dt, len(game.players)) == (7, 0.2, 2)
    player = game.players[0]
    assert player.state_bounds.upper[0] == (np.inf, np.inf, SPEED_LIMIT, SPEED_LIMIT)
    assert player.control_bounds.lower == ((-10.0, -10.0),)
    assert crosswalk_game(2, 7, dt=0.2) is game


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"players": 0}, "players: is 0"),
        ({"horizon": 0}, "horizon: is 0"),
    ],
)
def test_wrong_arguments_are_named(arguments, named):
    with pytest.raises(ValueError, match=named):
        crosswalk_game(**arguments)


def test_published_settings():
    np.testing.assert_array_equal(MONTE_CARLO.initial_state[:, :2], [[2.0, 2.0], [0.0, 2.0]])
    np.testing.assert_array_equal(MONTE_CARLO.goals, [[0.0, 0.0], [2.0, 0.0]])
    np.testing.assert_array_equal(HEATMAP.initial_state[0], [0.0, 2.0, 0.1, -0.2])
    for own, goal in zip(HEATMAP.theta, HEATMAP.goals, strict=True):
        np.testing.assert_array_equal(own["goal"], goal)


@pytest.mark.parametrize("players", range(2, 7))
def test_everybody_crosses_to_the_opposite_side(players):
    setting = nominal_setting(players)
    starts = setting.initial_state[:, :2]
    gaps = np.linalg.norm(starts[:, None] - starts, axis=2) + 10.0 * np.eye(players)
    assert gaps.min() > 1.59
    if players > 2:
        np.testing.assert_allclose(0.5 * (starts + setting.goals), 1.0)
    else:
        assert setting is MONTE_CARLO


@pytest.mark.parametrize("players", [1, 7])
def test_a_crossing_has_two_to_six(players):
    with pytest.raises(ValueError, match=f"players: is {players}"):
        nominal_setting(players)


@pytest.mark.parametrize("players", [2, 6])
def test_draws_are_legal_and_within_their_ranges(players):
    ranges = Ranges(
        gamma=(0.2, 0.4),
        start=0.35,
        goal=0.5,
        control_weight=(0.1, 0.2),
        collision_weight=(3.0, 4.0),
    )
    ranges.check()
    nominal = nominal_setting(players)
    for seed in range(50):
        drawn = draw_crossing(np.random.default_rng(seed), players, ranges)
        starts = drawn.initial_state[:, :2]
        gaps = np.linalg.norm(starts[:, None] - starts, axis=2) + 10.0 * np.eye(players)
        assert gaps.min() > COLLISION_DISTANCE
        assert np.abs(drawn.initial_state - nominal.initial_state).max() <= 0.35
        assert (drawn.initial_state[:, 2:] == 0.0).all()
        assert ((drawn.gamma >= 0.2) & (drawn.gamma <= 0.4)).all()
        for own, goal in zip(drawn.theta, nominal.goals, strict=True):
            assert set(own) == set(player_theta(goal))
            assert np.abs(own["goal"] - goal).max() <= 0.5
            assert 0.1 <= own["control_weight"] <= 0.2
            assert 3.0 <= own["collision_weight"] <= 4.0
    again = draw_crossing(np.random.default_rng(49), players, ranges)
    np.testing.assert_array_equal(again.initial_state, drawn.initial_state)


@pytest.mark.parametrize(
    ("ranges", "field"),
    [
        (Ranges(gamma=(0.9, 0.3)), "gamma"),
        (Ranges(gamma=(-0.1, 0.3)), "gamma"),
        (Ranges(gamma=0.5), "gamma"),
        (Ranges(start=0.4), "start"),
        (Ranges(goal=np.nan), "goal"),
        (Ranges(control_weight=(0.0, 1.0)), "control_weight"),
        (Ranges(collision_weight=(1.0, np.inf)), "collision_weight"),
    ],
)
def test_ranges_without_legal_draws_are_refused(ranges, field):
    with pytest.raises(ValueError, match=rf"ranges\.{field}: is"):
        ranges.check()
