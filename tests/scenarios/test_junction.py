"""Traffic at the junction: who takes part, what is drawn, what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.games import OutsideCircles, RoadBoundary
from foresight_env.games.footprints import Footprint, Motion, least_gap
from foresight_env.games.kinds import CAR, body_radius
from foresight_env.scenarios.junction import (
    JUNCTION_REGION,
    LANES,
    MOST,
    PENALTY,
    WHEELBASE,
    JunctionRanges,
    draw_junction,
    junction_game,
    junction_kinds,
)


@pytest.mark.parametrize(("pedestrians", "cars"), [(1, 1), (2, 3), (4, 4)])
def test_pedestrians_come_first_and_cars_have_their_lanes(pedestrians, cars):
    kinds = junction_kinds(pedestrians, cars)
    assert kinds == ("pedestrian",) * pedestrians + ("car",) * cars
    game = junction_game(pedestrians, cars, 5)
    assert [player.name for player in game.players] == list(kinds)
    assert game.horizon == 5
    for lane, player in zip(LANES, game.players[pedestrians:], strict=False):
        assert player.costs[-1].lane == lane
        assert player.dynamics.wheelbase == WHEELBASE
        assert {c.penalty for c in player.inequalities} == {PENALTY}


@pytest.mark.parametrize(
    ("pedestrians", "cars", "named"),
    [(0, 2, "pedestrians: is 0"), (2, 0, "cars: is 0"), (MOST + 1, 1, "pedestrians: is 5")],
)
def test_one_to_four_of_each(pedestrians, cars, named):
    for make in (junction_kinds, junction_game):
        with pytest.raises(ValueError, match=named):
            make(pedestrians, cars)


def test_a_car_may_take_its_weights_for_those_of_people():
    game = junction_game(1, 1, 5)
    drawn = draw_junction(np.random.default_rng(0), 1, 1)
    theta = [drawn.theta[1], drawn.theta[1]]
    check_parameters(game, drawn.initial_state, theta, drawn.gamma, "initial_state")


def shape(kind):
    if kind == "car":
        return Footprint(CAR.length, CAR.width)
    return Footprint(radius=body_radius(kind))


def still(state, kind):
    return Motion(state[:2], state[:2], state[3] if kind == "car" else 0.0, 0.0)


def test_draws_are_legal_and_within_their_ranges():
    ranges = JunctionRanges((0.4, 0.5), 3.0, 1.0, 1.5, 0.5, (40.0, 50.0))
    ranges.check()
    kinds = junction_kinds(4, 4)
    nominal = draw_junction(
        np.random.default_rng(0), 4, 4, JunctionRanges((1.0, 1.0), 0.0, 0.0, 0.0, 0.0)
    )
    for seed in range(20):
        drawn = draw_junction(np.random.default_rng(seed), 4, 4, ranges)
        assert ((drawn.gamma >= 0.4) & (drawn.gamma <= 0.5)).all()
        moved = drawn.initial_state - nominal.initial_state
        assert np.abs(moved[:4, :2]).max() <= 1.0
        assert (moved[:4, 2:] == 0.0).all()
        assert np.linalg.norm(moved[4:, :2], axis=1).max() <= 3.0
        heading = nominal.initial_state[4:, 3]
        across = np.cos(heading) * moved[4:, 1] - np.sin(heading) * moved[4:, 0]
        np.testing.assert_allclose(across, 0.0, atol=1e-9)  # along their headings
        assert np.abs(moved[4:, 2]).max() <= 1.5
        assert (drawn.initial_state[4:, 2] > 0.0).all()
        for own, before, kind in zip(drawn.theta, nominal.theta, kinds, strict=True):
            assert np.abs(own["goal"] - before["goal"]).max() <= 0.5
            assert 40.0 <= own["collision_weight"] <= 50.0
            assert ("lane_weight" in own) == (kind == "car")
        for i, state in enumerate(drawn.initial_state):
            if kinds[i] == "car":  # on the road
                at = (jnp.asarray(state),)
                assert OutsideCircles(JUNCTION_REGION.corners)(0, 1, at, (), {}).min() > 0.0
                assert RoadBoundary(JUNCTION_REGION.sides)(0, 1, at, (), {}).min() > 0.0
            for j in range(i):
                if "car" not in (kinds[i], kinds[j]):
                    continue  # people may touch
                both = [still(drawn.initial_state[k], kinds[k]) for k in (i, j)]
                assert least_gap(shape(kinds[i]), shape(kinds[j]), *both) > 0.0


@pytest.mark.parametrize(
    ("ranges", "field"),
    [
        (JunctionRanges(gamma=(1.0, 0.3)), "gamma"),
        (JunctionRanges(along=3.5), "along"),
        (JunctionRanges(place=2.0), "place"),
        (JunctionRanges(speed=-1.0), "speed"),
        (JunctionRanges(goal=np.inf), "goal"),
        (JunctionRanges(collision_weight=(0.0, 1.0)), "collision_weight"),
    ],
)
def test_ranges_without_legal_draws_are_refused(ranges, field):
    with pytest.raises(ValueError, match=rf"ranges\.{field}: is"):
        ranges.check()
