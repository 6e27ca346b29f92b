"""The driving game by its definition: what a car pays, its limits, what is refused, draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import FootprintProximity, stage_cost
from foresight_env.games.kinds import SIMULATED_CAR
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.highway.scenes import SCENES, draw_driving
from foresight_env.scenarios.driving import (
    ACCELERATION_LIMIT,
    LANE_HALF_WIDTH,
    LANE_PENALTY,
    SPEED_LIMIT,
    STEERING_LIMIT,
    driving_game,
    player_theta,
)

AHEAD = np.column_stack([2.0 * np.arange(30), np.zeros((30, 3))])
"""A path along the x axis."""


def paid(game, theta, *states, control=(0.0, 0.0)):
    with jax.enable_x64(True):
        x = tuple(jnp.asarray(state, float) for state in states)
        u = (jnp.asarray(control, float), *(jnp.zeros(2) for _ in states[1:]))
        discounted, flat = stage_cost(game, 0, 1, x, u, theta)
    assert float(flat) == 0.0
    return float(discounted)


def test_a_car_alone_pays_for_path_speed_and_controls():
    game, theta = driving_game(1, 4), player_theta(AHEAD, 8.0, AHEAD[-1, :2])
    theta = {**theta, "path_weight": 2.0, "speed_weight": 0.5}
    assert paid(game, theta, [20.0, 0.0, 8.0, 0.0]) == pytest.approx(0.0, abs=1e-9)
    assert paid(game, theta, [20.0, 0.5, 8.0, 0.0]) == pytest.approx(2.0 * 0.25, rel=1e-6)
    assert paid(game, theta, [20.0, 0.0, 6.0, 0.0]) == pytest.approx(0.5 * 4.0)
    controls = theta["control_weight"] * 4.0 + theta["steering_weight"] * 0.01
    found = paid(game, theta, [20.0, 0.0, 8.0, 0.0], control=(2.0, 0.1))
    assert found == pytest.approx(controls, rel=1e-6)


def test_beyond_the_lane_a_car_pays_per_metre():
    game, theta = driving_game(1, 4), player_theta(AHEAD, 8.0, AHEAD[-1, :2], path_weight=0.0)
    inside = paid(game, theta, [20.0, LANE_HALF_WIDTH, 8.0, 0.0])
    outside = paid(game, theta, [20.0, LANE_HALF_WIDTH + 0.2, 8.0, 0.0])
    assert inside == pytest.approx(0.0, abs=1e-6)
    assert outside == pytest.approx(0.2 * LANE_PENALTY, rel=1e-6)


def test_cars_pay_for_coming_too_near():
    game = driving_game(2, 4)
    theta = player_theta(AHEAD, 8.0, AHEAD[-1, :2], collision_weight=3.0, collision_distance=3.0)
    own, far = [20.0, 0.0, 8.0, 0.0], [40.0, 0.0, 8.0, 0.0]
    near = [25.0, 0.0, 8.0, 0.0]  # front disc to rear disc 2.5 m
    assert paid(game, theta, own, far) == pytest.approx(0.0, abs=1e-9)
    assert paid(game, theta, own, near) == pytest.approx(3.0 * 0.5**2)
    costs = [type(cost) for cost in driving_game(1, 4).players[0].costs]
    assert FootprintProximity not in costs


def test_the_goal_costs_nothing_and_every_road_has_the_same_game():
    game, own = driving_game(1, 4), player_theta(AHEAD, 8.0, (0.0, 0.0))
    state = [20.0, 0.3, 7.0, 0.1]
    assert paid(game, own, state) == paid(game, {**own, "goal": np.array([9.0, 9.0])}, state)
    assert driving_game(1, 4) is game


def test_limits():
    car = driving_game(2, 4, dt=0.2, substeps=1).players[0]
    assert car.dynamics.dt == 0.2
    assert car.dynamics.substeps == 1
    assert car.dynamics.length == SIMULATED_CAR.length
    assert car.state_bounds.lower[0][2] == 0.0
    assert car.state_bounds.upper[0][2] == SPEED_LIMIT
    assert car.control_bounds.upper == ((ACCELERATION_LIMIT, STEERING_LIMIT),)


def test_a_game_without_cars_is_refused():
    with pytest.raises(ValueError, match="cars: is 0"):
        driving_game(0)


@pytest.mark.parametrize("name", SCENES)
def test_draws_are_on_their_paths_and_within_their_ranges(name):
    scene, ranges = SCENES[name], DrivingRanges(gamma=(0.5, 0.6), along=2.0, speed=1.0)
    ranges.check()
    for seed in range(10):
        drawn = draw_driving(np.random.default_rng(seed), scene, 6, ranges)
        assert ((drawn.gamma >= 0.5) & (drawn.gamma <= 0.6)).all()
        for state, own, journey in zip(
            drawn.initial_state, drawn.theta, scene.journeys, strict=True
        ):
            places = own["path"][:, :2]
            assert np.linalg.norm(places - state[:2], axis=1).min() < 1.1
            assert np.linalg.norm(places - own["goal"], axis=1).min() < 1.1
            assert abs(state[2] - journey.speed) <= 1.0
            assert abs(own["target_speed"] - journey.target_speed) <= 1.0
            assert 0.0 <= state[2] <= SPEED_LIMIT


@pytest.mark.parametrize(
    ("ranges", "field"),
    [
        (DrivingRanges(gamma=(1.0, 0.3)), "gamma"),
        (DrivingRanges(along=2.5), "along"),
        (DrivingRanges(speed=-1.0), "speed"),
    ],
)
def test_ranges_without_legal_draws_are_refused(ranges, field):
    with pytest.raises(ValueError, match=rf"ranges\.{field}: is"):
        ranges.check()
