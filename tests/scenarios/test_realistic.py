"""The realistic game by its definition: costs, limits, discounting, and an equilibrium."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import solve, verify
from foresight_env.games import DoubleIntegrator, SmoothVehicle, stage_cost
from foresight_env.scenarios.realistic import (
    DRIVING_MARGIN,
    HEADWAY,
    LIMIT_PENALTY,
    MOST_JERK,
    MOST_LATERAL_ACCELERATION,
    DrivingWeights,
    PreferredMotion,
    WalkingWeights,
    driver_theta,
    realistic_game,
    walker_theta,
)

STILL = np.zeros(2)
FAR_CAR = np.array([99.0, 0.0, 0.0, 0.0, 0.0, 0.0])
FAR_WALKER = np.array([99.0, 0.0, 0.0, 0.0])


def paid(game, i, theta, states, controls):
    with jax.enable_x64(True):
        x, u = (tuple(jnp.asarray(v, float) for v in values) for values in (states, controls))
        return float(stage_cost(game, i, 1, x, u, theta)[0])


def test_drivers_pay_for_speed_jerk_and_steering():
    game = realistic_game(("car", "pedestrian"), (False, False), 4, 0.4)
    weights = DrivingWeights(2.0, 3.0, 5.0, 7.0, 11.0, 13.0)
    theta = driver_theta(PreferredMotion(6.0, np.zeros(3), 0.05), weights)
    state = np.array([0.0, 0.0, 4.0, 0.3, 0.5, 0.1])  # on the arc, at its begin
    control = np.array([0.2, 0.03])
    expected = (
        2.0 * (4.0 - 6.0) ** 2
        + 3.0 * 0.5**2
        + 5.0 * 0.2**2
        + 7.0 * (0.1 - 0.05) ** 2
        + 11.0 * 0.03**2
        + 13.0 * (16.0 * 0.1) ** 2
    )
    assert paid(game, 0, theta, (state, FAR_WALKER), (control, STILL)) == pytest.approx(expected)


def test_drivers_pay_for_leaving_their_route():
    straight = np.stack([np.arange(0.0, 60.0, 2.0), *np.zeros((3, 30))], axis=1)
    game = realistic_game(("car", "pedestrian"), (True, False), 4, 0.4)
    theta = driver_theta(
        PreferredMotion(5.0, np.zeros(3), path=straight), DrivingWeights(path_weight=3.0)
    )
    assert "curvature" not in theta
    on, off = (np.array([20.0, y, 5.0, 0.0, 0.0, 0.0]) for y in (0.0, 0.7))
    assert paid(game, 0, theta, (on, FAR_WALKER), (STILL, STILL)) == pytest.approx(0.0, abs=1e-9)
    away = paid(game, 0, theta, (off, FAR_WALKER), (STILL, STILL))
    assert away == pytest.approx(3.0 * 0.7**2, rel=1e-6)


def test_people_keep_their_velocity():
    game = realistic_game(("pedestrian", "bicycle"), (False, False), 4, 0.4)
    theta = walker_theta(np.array([1.0, 0.0]), WalkingWeights(2.0, 3.0))
    turned = [0.0, 0.0, 0.0, 1.0]
    pushed = np.array([0.3, 0.4])
    cost = paid(game, 0, theta, (turned, FAR_WALKER), (pushed, STILL))
    assert cost == pytest.approx(2.0 * 2.0 + 3.0 * 0.25)


def test_conflicts_have_a_slope_inside_the_bodies():
    """Closer costs more, down to bodies on top of each other."""
    game = realistic_game(("car", "pedestrian"), (False, False), 4, 0.4)
    theta = driver_theta(PreferredMotion(0.0, np.zeros(3)))
    own = np.zeros(6)
    costs = [
        paid(game, 0, theta, (own, np.array([gap, 0.0, 0.0, 0.0])), (STILL, STILL))
        for gap in (0.3, 1.0, 2.0, 3.0, 8.0)
    ]
    assert (np.diff(costs) < 0.0).all()
    assert costs[-1] == 0.0


def test_drivers_keep_a_time_gap():
    """Agents ahead count earlier the faster the car is; people see the car's gap, too."""
    game = realistic_game(("car", "pedestrian"), (False, False), 4, 0.4)
    ahead = np.array([4.0 + DRIVING_MARGIN + HEADWAY * 5.0, 0.0, 0.0, 0.0])
    person = walker_theta(np.zeros(2))
    for player, theta_of in (
        (0, lambda v: driver_theta(PreferredMotion(v, np.zeros(3)))),
        (1, lambda v: person),
    ):
        slow, fast = (
            paid(game, player, theta_of(v), (np.array([0, 0, v, 0, 0, 0]), ahead), (STILL, STILL))
            for v in (0.0, 10.0)
        )
        assert slow == 0.0
        assert fast > 0.0


def test_limits_are_elastic():
    game = realistic_game(("car",), (False,), 4, 0.4)
    nothing = {name: 0.0 for name in DrivingWeights._fields}
    theta = {**driver_theta(PreferredMotion(0.0, np.zeros(3))), **nothing}
    backward = np.array([0.0, 0.0, -0.5, 0.0, 0.0, 0.0])
    assert paid(game, 0, theta, (backward,), (STILL,)) == pytest.approx(0.5 * LIMIT_PENALTY)
    curvature = (MOST_LATERAL_ACCELERATION + 1.0) / 100.0
    sideways = np.array([0.0, 0.0, 10.0, 0.0, 0.0, -curvature])
    assert paid(game, 0, theta, (sideways,), (STILL,)) == pytest.approx(LIMIT_PENALTY)


def test_discount_factors_are_per_second():
    for dt in (0.1, 0.4):
        player = realistic_game(("car",), (False,), 4, dt).players[0]
        with jax.enable_x64(True):
            second = float(player.discounting.weight(jnp.asarray(1.0 / dt), jnp.asarray(0.6)))
        assert second == pytest.approx(0.6)


def test_kinds_move_by_their_dynamics_and_bad_input_is_refused():
    game = realistic_game(("pedestrian", "bicycle", "car"), (False, False, True), 4, 0.4)
    kinds = [type(p.dynamics) for p in game.players]
    assert kinds == [DoubleIntegrator, DoubleIntegrator, SmoothVehicle]
    with pytest.raises(ValueError, match="kinds: is empty"):
        realistic_game((), (), 4, 0.4)
    with pytest.raises(ValueError, match="routed: has 1 entries; expected one per agent, 2"):
        realistic_game(("car", "car"), (True,), 4, 0.4)
    with pytest.raises(ValueError, match=r"routed\[1\]: agent 1 is a pedestrian"):
        realistic_game(("car", "pedestrian"), (True, True), 4, 0.4)


def test_a_car_gives_way_to_a_person_and_drives_like_a_car():
    """An equilibrium, verified; acceleration and curvature change no faster than a car's can."""
    kinds, dt = ("car", "pedestrian"), 0.4
    game = realistic_game(kinds, (False, False), 20, dt)
    start = [np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0]), np.array([16.0, -1.0, 0.0, 0.8])]
    theta = [
        driver_theta(
            PreferredMotion(6.0, np.zeros(3)),
            DrivingWeights(path_weight=30.0, collision_weight=30.0),
        ),
        walker_theta(np.array([0.0, 0.8]), WalkingWeights(collision_weight=0.0)),
    ]
    gamma = np.array([0.8, 0.8])
    found = solve(game, start, theta, gamma, throw=True)
    assert verify(game, found, theta, gamma).is_local_equilibrium
    car, person = (np.asarray(s) for s in found.states)
    assert car[:, 2].min() < 4.0  # it slows down for the person
    assert car[-1, 2] > car[:, 2].min()  # and continues
    assert np.linalg.norm(car[:, :2] - person[:, :2], axis=1).min() > 2.0
    # Far from the limits of what a car can: nothing forces it.
    assert np.abs(np.diff(car[:, 4])).max() < 0.5 * MOST_JERK * dt
    assert np.abs(car[:, 2] ** 2 * car[:, 5]).max() < MOST_LATERAL_ACCELERATION
