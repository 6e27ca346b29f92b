"""The intersection: its published instance is solved, and recordings become settings."""

import jax.numpy as jnp
import numpy as np
import pytest

from evaluation.windows.junction import recorded_setting
from foresight_env.datasets import Recording, Track
from foresight_env.equilibrium import Status, solve, verify
from foresight_env.games.roads import OutsideCircles, RoadBoundary
from foresight_env.scenarios.aachen import AACHEN, AACHEN_TURNING, AACHEN_TURNING_POLYNOMIAL
from foresight_env.scenarios.intersection import (
    PEDESTRIAN_SHRINK,
    intersection_game,
    player_theta,
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
    """A pedestrian and the car that turns; all four are a study of their own (`benchmarks`)."""
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


def track(name, kind, start, velocity, first=0, heading=np.nan, count=8):
    steps = np.arange(count)
    return Track(
        name,
        kind,
        first + steps,
        np.asarray(start) + 0.25 * steps[:, None] * np.asarray(velocity),
        np.tile(np.asarray(velocity, dtype=float), (count, 1)),
        np.full(count, heading),
    )


def recording(*tracks):
    return Recording("made", "ind", 4.0, tracks)


def test_a_recorded_window_becomes_a_setting():
    made = recording(
        track("1", "pedestrian", (0.0, 0.0), (0.0, 1.5)),
        track("2", "car", (-9.0, 3.0), (3.0, -4.0)),
        track("3", "truck_bus", (0.0, 20.0), (0.0, 0.0), heading=1.2),
    )
    setting = recorded_setting(made.window(("1", "2", "3"), 0, 8))
    assert setting.kinds == ("pedestrian", "car", "truck_bus")
    np.testing.assert_allclose(setting.initial_state[0], [0.0, 0.0, 0.0, 1.5])
    np.testing.assert_allclose(setting.initial_state[1], [-9.0, 3.0, 5.0, np.arctan2(-4.0, 3.0)])
    np.testing.assert_allclose(setting.initial_state[2], [0.0, 20.0, 0.0, 1.2])
    np.testing.assert_allclose(setting.goals, [[0.0, 2.625], [-3.75, -4.0], [0.0, 20.0]])
    person, car, standing = setting.lanes
    assert (person, standing) == (None, None)
    np.testing.assert_allclose(car.offset(jnp.array([-6.0, -1.0])), 0.0, atol=1e-4)


def test_a_setting_begins_where_everybody_is_there():
    made = recording(
        track("1", "pedestrian", (0.0, 0.0), (0.0, 1.5)),
        track("2", "car", (-9.0, 3.0), (3.0, -4.0), first=2),
    )
    with pytest.raises(ValueError, match="window: 2 not seen in its first frame, 0"):
        recorded_setting(made.window(("1", "2"), 0, 8))
    begun = recorded_setting(made.window(("1", "2"), 2, 8))
    # The person is gone two frames before the end; the goal is where it was seen last.
    np.testing.assert_allclose(begun.goals[0], [0.0, 2.625])


def test_windows_that_make_no_setting_are_refused():
    standing = recording(track("3", "car", (0.0, 20.0), (0.0, 0.0))).window(("3",), 0, 8)
    with pytest.raises(ValueError, match="window: 3 stands in its first frame"):
        recorded_setting(standing)
    moving = recording(track("2", "car", (-9.0, 3.0), (3.0, -4.0))).window(("2",), 0, 8)
    with pytest.raises(ValueError, match="lanes: has 2 entries; expected one per agent, 1"):
        recorded_setting(moving, lanes=(None, None))


def test_only_cars_have_a_lane_weight():
    assert "lane_weight" not in player_theta("pedestrian", (0.0, 0.0))
    assert player_theta("truck_bus", (0.0, 0.0))["lane_weight"] > 0.0
