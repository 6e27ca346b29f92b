"""First guesses of states from observations."""

import numpy as np
import pytest

from foresight_env.games import (
    Effort,
    Game,
    Goal,
    KinematicBicycle,
    ObservationModel,
    Player,
    full_state,
)
from foresight_env.games.arc import arc
from foresight_env.inverse import NeverSeenError, guess_initial_state
from tests.support.small_games import Linear

WALKER = Linear.of(np.eye(2), 0.2 * np.eye(2))
GAME = Game(
    (Player(KinematicBicycle(0.2), (Goal(), Effort())), Player(WALKER, (Goal(), Effort()))), 5
)


def places(states):
    return np.concatenate([s[:2] for s in states])


MODEL = ObservationModel(places, (0, 0, 1, 1))


def straight(count=5):
    times = 0.2 * np.arange(count)[:, None]
    car = np.array([1.0, 2.0]) + times * np.array([0.6, 0.8])
    return np.concatenate([car, np.full((count, 2), 3.0)], axis=1)


def test_states_of_any_size():
    car, walker = guess_initial_state(GAME, MODEL, straight())
    np.testing.assert_allclose(car, [1.0, 2.0, 1.0, np.arctan2(0.8, 0.6)])
    np.testing.assert_allclose(walker, [3.0, 3.0])


def test_an_agent_seen_late_is_moved_back():
    seen = straight()
    seen[:2, :2] = np.nan
    car, _ = guess_initial_state(GAME, MODEL, seen)
    np.testing.assert_allclose(car, [1.0, 2.0, 1.0, np.arctan2(0.8, 0.6)])


def test_a_turning_vehicle_seen_late_is_moved_back_along_its_circle():
    turn, speed = 0.5, 3.0
    times = 0.2 * np.arange(6)
    places = arc(np.array([speed, 0.0]), turn, times)
    car = np.column_stack([places, np.full(6, speed), turn * times])
    seen = np.column_stack([car, np.full((6, 2), 3.0)])
    seen[:3, :4] = np.nan
    model = full_state(GAME.state_sizes)
    found, _ = guess_initial_state(GAME, model, seen)
    np.testing.assert_allclose(found, [0.0, 0.0, speed, 0.0], atol=1e-9)


def test_an_agent_that_nobody_saw():
    seen = straight()
    seen[:, 2:] = np.nan
    with pytest.raises(NeverSeenError, match="player 1 was never observed"):
        guess_initial_state(GAME, MODEL, seen)
