"""The intersection: its published instance is solved."""

import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import Status, solve, verify
from foresight_env.games.roads import OutsideCircles, RoadBoundary
from foresight_env.scenarios.aachen import AACHEN, AACHEN_TURNING, AACHEN_TURNING_POLYNOMIAL
from foresight_env.scenarios.intersection import (
    PEDESTRIAN_SHRINK,
    intersection_game,
    player_theta,
    violations,
)


@pytest.mark.parametrize("gamma", [1.0, 0.6])
def test_the_published_car_turns_from_a_cold_start(gamma):
    game = intersection_game(AACHEN.kinds[2:3], AACHEN.lanes[2:3], AACHEN.region)
    found = solve(game, AACHEN.initial_state[2:3], AACHEN.theta[2:3], gamma)
    assert found.status == Status.SOLVED
    places = np.asarray(found.states[0])[:, :2]
    assert np.hypot(*(places - AACHEN.goals[2]).T).min() < 2.0
    for place in places:
        at = (jnp.array([*place, 0.0, 0.0]),)
        assert OutsideCircles(AACHEN.region.corners)(0, 1, at, (), {}).min() > -1e-4
        assert RoadBoundary(AACHEN.region.sides)(0, 1, at, (), {}).min() > -1e-4


def test_the_published_game_is_an_equilibrium():
    """A pedestrian and the car that turns; all four are a separate study (`benchmarks`)."""
    pair = slice(1, 3)
    game = intersection_game(AACHEN.kinds[pair], AACHEN.lanes[pair], AACHEN.region, horizon=6)
    gamma, theta = np.array([1.0, 0.7]), AACHEN.theta[pair]
    found = solve(game, AACHEN.initial_state[pair], theta, gamma)
    assert found.status == Status.SOLVED
    assert verify(game, found, theta, gamma).is_local_equilibrium


def test_the_fitted_lane_follows_the_published_polynomial():
    published = AACHEN_TURNING_POLYNOMIAL.points(np.linspace(-26.5, -12.5, 100))
    own = AACHEN_TURNING.points(np.linspace(*AACHEN_TURNING.reach, 400))
    gaps = np.min(np.hypot(*(published[:, None] - own[None]).transpose(2, 0, 1)), axis=1)
    assert gaps.max() < 0.5


def test_pedestrians_walk_on_the_corners():
    game = intersection_game(AACHEN.kinds, AACHEN.lanes, AACHEN.region)
    shrinks = {p.name: p.inequalities[0].function.shrink for p in game.players}
    assert shrinks == {"pedestrian": PEDESTRIAN_SHRINK, "car": 1.0}
    assert len(game.players[0].inequalities) == 1  # road sides are for cars


def test_a_game_may_be_elastic_and_its_cars_longer():
    game = intersection_game(("car",), (None,), AACHEN.region, wheelbase=2.7, penalty=5.0)
    assert [c.penalty for c in game.players[0].inequalities] == [5.0, 5.0]
    assert game.players[0].dynamics.wheelbase == 2.7


@pytest.mark.parametrize(
    ("kinds", "lanes", "message"),
    [
        ((), (), "kinds: is empty"),
        (("car",), (), "lanes: has 0 entries"),
        (("pedestrian",), (AACHEN_TURNING,), r"lanes\[0\]: agent 0 is a pedestrian"),
    ],
)
def test_wrong_agents_are_named(kinds, lanes, message):
    with pytest.raises(ValueError, match=message):
        intersection_game(kinds, lanes)


def test_only_cars_have_a_lane_weight():
    assert "lane_weight" not in player_theta("pedestrian", (0.0, 0.0))
    assert player_theta("truck_bus", (0.0, 0.0))["lane_weight"] > 0.0


def test_an_agent_that_was_never_seen_contradicts_nothing():
    assert violations("car", AACHEN.region, np.full((3, 2), np.nan)) == ()
