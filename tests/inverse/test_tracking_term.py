"""Tracking term: its games by their definition, and the fits that begin with them."""

import jax
import numpy as np
import pytest

from benchmarks.synthetic_windows import DEVELOPMENT, GOOD, Published, fitted
from foresight_env.equilibrium import Status, solve
from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.rollout import rollout
from foresight_env.equilibrium.newton.start import from_controls
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.games import Game, Player, full_state, positions
from foresight_env.games.constraints import Bounds
from foresight_env.games.costs import Effort, Goal
from foresight_env.games.dynamics import KinematicBicycle
from foresight_env.inverse import Free, GaussNewton, MultiStart, Prior, estimate
from foresight_env.inverse.coordinates import Coordinates
from foresight_env.inverse.fit import Data, Problem
from foresight_env.inverse.tracking import track
from foresight_env.inverse.tracking_term import (
    PRECISION,
    TARGET,
    WEIGHT,
    control_curvature,
    tracking_precision,
    with_tracking,
    with_tracking_cost,
    without_tracking,
)
from foresight_env.scenarios.crosswalk import CONTROL_WEIGHT, MONTE_CARLO, crosswalk_game
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_GOALS,
    CROSSING_STATES,
    crossing,
    crossing_theta,
)


def tracked_solution(target, weight, theta, gamma=CROSSING_GAMMA):
    """(T + 1, 8) joint states of the equilibrium with a tracking term of this weight."""
    own = [
        {**t, WEIGHT: weight, TARGET: target[1:, 4 * i : 4 * i + 4], PRECISION: np.ones((8, 4))}
        for i, t in enumerate(theta)
    ]
    found = solve(with_tracking_cost(crossing()), CROSSING_STATES, own, gamma)
    assert found.status == Status.SOLVED
    return np.concatenate(found.states, axis=1)


@pytest.fixture(scope="module")
def played():
    found = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
    return np.concatenate(found.states, axis=1)


@pytest.mark.parametrize("weight", [0.0, 0.1, 100.0])
def test_an_equilibrium_is_that_of_the_game_that_tracks_it(played, weight):
    found = tracked_solution(played, weight, crossing_theta())
    np.testing.assert_allclose(found, played, atol=1e-5)


def test_at_poor_parameters_the_weight_decides_how_near_the_target_is(played):
    poor = crossing_theta(CROSSING_GOALS + 0.5)
    gaps = [
        np.linalg.norm(tracked_solution(played, weight, poor, [0.5, 0.5]) - played)
        for weight in (0.0, 1.0, 1e4)
    ]
    assert gaps[0] > gaps[1] > gaps[2]
    assert gaps[2] < 1e-2 < 0.3 < gaps[0]


def test_precisions_are_information_times_the_price_of_controls():
    game = crosswalk_game(2, horizon=4)
    layout = layout_of(game)
    theta = MONTE_CARLO.theta
    with jax.enable_x64(True):
        parameters = Parameters(np.concatenate(CROSSING_STATES), theta, np.ones(2))
        point = from_controls(layout, SolverOptions(), parameters, np.zeros((4, 4)))
        for i in range(2):
            assert control_curvature(layout, i, parameters, point) == pytest.approx(CONTROL_WEIGHT)
        # Positions of x_1 to x_4 with deviations 1 and 2: x_5 was not observed.
        whiten = np.tile(np.diag([1.0, 1.0, 0.5, 0.5]), (4, 1, 1))
        found = tracking_precision(layout, positions((4, 4)), whiten, parameters, point)
    expected = CONTROL_WEIGHT * np.array([1.0, 1.0, 0.0, 0.0, 0.25, 0.25, 0.0, 0.0])
    np.testing.assert_allclose(found[:3], np.tile(expected, (3, 1)))
    np.testing.assert_array_equal(found[3], 0.0)


def test_parameters_are_the_games_own_afterwards(played):
    layout = layout_of(with_tracking_cost(crossing()))
    theta = tuple(crossing_theta())
    with jax.enable_x64(True):
        parameters = Parameters(np.concatenate(CROSSING_STATES), theta, np.ones(2))
        added = with_tracking(layout, parameters, played[1:], np.ones((8, 8)))
    assert WEIGHT in added.theta[0]
    assert [set(t) for t in without_tracking(added.theta)] == [set(t) for t in theta]
    found = estimate(
        crossing(), played, full_state((4, 4)), initial_state=CROSSING_STATES, theta=theta,
        gamma=[0.8, 0.8], covariance=1e-4, prior=Prior(0.0),
    )  # fmt: skip
    assert [set(t) for t in found.theta] == [set(t) for t in theta]


def test_the_fit_is_the_same_minimum_with_and_without(played):
    noisy = played + 0.005 * np.random.default_rng(3).standard_normal(played.shape)
    fits = [
        estimate(
            crossing(), noisy, full_state((4, 4)), initial_state=CROSSING_STATES,
            theta=crossing_theta(), gamma=[0.8, 0.8], free=Free(), covariance=0.005**2,
            prior=Prior(0.0), method=method,
        )
        for method in (GaussNewton(), GaussNewton(tracking_weights=()))
    ]  # fmt: skip
    assert fits[0].cost == pytest.approx(fits[1].cost, rel=1e-3)
    np.testing.assert_allclose(fits[0].values, fits[1].values, atol=1e-2)


def test_weights_are_positive():
    with pytest.raises(ValueError, match=r"tracking_weights: is \(1.0, 0.0\); expected positive"):
        GaussNewton(tracking_weights=(1.0, 0.0))


def test_a_car_that_turns_by_half_a_circle_per_stage_is_followed():
    limit = np.array([5.0, np.pi / 4])
    car = Player(
        KinematicBicycle(0.24, 1.0),
        (Goal(1.0), Effort(1.0)),
        control_bounds=Bounds.box(-limit, limit, 2),
    )
    game, random = Game((car,), 12), np.random.default_rng(0)
    layout, model = layout_of(game), full_state((4,))
    first = np.array([0.0, 0.0, 12.5, 0.0])
    steering = 0.78 * random.choice([-1.0, 1.0], 12)
    with jax.enable_x64(True):
        controls = np.stack([np.zeros(12), steering], axis=1)
        clean = np.concatenate([first[None], rollout(layout, first, controls)])
        noisy = clean + 0.05 * random.standard_normal(clean.shape)
        parameters = Parameters(first, ({"goal": np.zeros(2)},), np.ones(1))
        coordinates, _ = Coordinates.of(layout, Free(), parameters)
        empty = np.zeros(coordinates.kinds.size)
        whiten = np.tile(np.eye(4) / 0.05, (13, 1, 1))
        data = Data(noisy, whiten, empty, np.zeros((1, empty.size)), empty, empty, empty)
        problem = Problem(layout, coordinates, model, SolverOptions())
        found = np.asarray(rollout(layout, first, track(problem, data, parameters)))
    assert np.sqrt(np.mean((found - clean[1:]) ** 2)) < 0.1


def test_windows_of_the_published_game_are_explained_to_within_the_noise():
    """From one start, on development seeds."""
    family = Published(2.7)
    for seed in (DEVELOPMENT, DEVELOPMENT + 1, DEVELOPMENT + 2):
        window = family.window(seed, 0.1)
        assert window is not None
        assert fitted(family, window, MultiStart(1)).objective < GOOD
