"""The encounter by its definition: what people and vehicles pay, and the distances they want."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import CurvatureVehicle, DoubleIntegrator, stage_cost
from foresight_env.scenarios.encounter import (
    PERSONAL_SPACE,
    VEHICLE_BERTH,
    VEHICLE_DISTANCE,
    encounter_game,
    player_theta,
    wanted_distance,
)


def paid(game, i, theta, states, controls):
    with jax.enable_x64(True):
        x, u = (tuple(jnp.asarray(v, float) for v in values) for values in (states, controls))
        return float(stage_cost(game, i, 1, x, u, theta)[0])


STILL = np.zeros(2)
FAR = np.array([99.0, 0.0, 0.0, 0.0])


def test_people_keep_their_velocity():
    game = encounter_game(("pedestrian", "pedestrian"), 4, 0.4)
    theta = {**player_theta("pedestrian", np.array([1.0, 0.0])), "cruise_weight": 2.0}
    walking = [0.0, 0.0, 1.0, 0.0]
    assert paid(game, 0, theta, (walking, FAR), (STILL, STILL)) == 0.0
    turned = [0.0, 0.0, 0.0, 1.0]
    assert paid(game, 0, theta, (turned, FAR), (STILL, STILL)) == pytest.approx(4.0)
    pushed = paid(game, 0, theta, (walking, FAR), (np.array([0.3, 0.4]), STILL))
    assert pushed == pytest.approx(0.25 * theta["control_weight"])


def test_vehicles_keep_their_speed_and_curvature():
    game = encounter_game(("car", "pedestrian"), 4, 0.4)
    theta = player_theta("car", (6.0, 0.05))
    driving = [0.0, 0.0, 6.0, 0.0]
    kept = np.array([0.0, 0.05])
    assert paid(game, 0, theta, (driving, FAR), (kept, STILL)) == pytest.approx(0.0)
    slower = [0.0, 0.0, 4.0, 0.0]
    expected = 4.0 * theta["cruise_weight"]
    assert paid(game, 0, theta, (slower, FAR), (kept, STILL)) == pytest.approx(expected)
    straight = paid(game, 0, theta, (driving, FAR), (STILL, STILL))
    assert straight == pytest.approx(0.05**2 * theta["turn_weight"])


@pytest.mark.parametrize(
    ("kind", "other", "distance"),
    [
        ("pedestrian", "pedestrian", 2.0 * PERSONAL_SPACE["pedestrian"]),
        ("pedestrian", "bicycle", PERSONAL_SPACE["pedestrian"] + PERSONAL_SPACE["bicycle"]),
        ("pedestrian", "car", VEHICLE_BERTH + PERSONAL_SPACE["pedestrian"]),
        ("car", "truck_bus", VEHICLE_DISTANCE),
    ],
)
def test_wanted_distances(kind, other, distance):
    assert wanted_distance(kind, other) == wanted_distance(other, kind) == pytest.approx(distance)
    game = encounter_game((kind, other), 4, 0.4)
    wish = np.zeros(2)
    theta = {**player_theta(kind, wish), "collision_weight": 0.3}
    near = np.array([distance - 0.2, 0.0, 0.0, 0.0])
    own = np.zeros(4)
    assert paid(game, 0, theta, (own, near), (STILL, STILL)) == pytest.approx(0.3 * 0.2**2)
    beyond = np.array([distance + 0.01, 0.0, 0.0, 0.0])
    assert paid(game, 0, theta, (own, beyond), (STILL, STILL)) == 0.0


def test_kinds_move_by_their_dynamics():
    game = encounter_game(("pedestrian", "bicycle", "car"), 4, 0.4)
    assert [type(p.dynamics) for p in game.players] == [
        DoubleIntegrator,
        DoubleIntegrator,
        CurvatureVehicle,
    ]
    assert (game.horizon, game.dt) == (4, 0.4)
    with pytest.raises(ValueError, match="kinds: is empty"):
        encounter_game((), 4, 0.4)


def test_only_vehicles_have_a_speed_and_a_curvature():
    walker, car = player_theta("pedestrian", (1.0, 2.0)), player_theta("car", (5.0, 0.1))
    assert set(car) - set(walker) == {"speed", "curvature", "turn_weight"}
    assert (car["speed"], car["curvature"]) == (5.0, 0.1)
    assert walker["velocity"] == (1.0, 2.0)
