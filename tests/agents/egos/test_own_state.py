"""The ego's own state: what it did is known, what it sees is noisy."""

import numpy as np
import pytest

from agents.egos.own_state import OwnState, _moved, follow_own_state, observation_variance
from agents.egos.perception import Perception
from foresight_env.envs.crosswalk_v0 import parallel_env
from foresight_env.envs.driving_v0 import parallel_env as driving_env
from foresight_env.games import DoubleIntegrator

NOISE = 0.1


def scene_of(make, observation, noise=NOISE, **setting):
    env = make(controlled=(0,), observation=observation, noise_std=noise, **setting)
    env.reset(seed=0)
    return env.scene


def drive(scene, steps, seed, *, noise=NOISE, missing=0.0):
    """True and estimated states of an ego that does random things."""
    random = np.random.default_rng(seed)
    model = scene.observation_model(0)
    mine = [k for k, owner in enumerate(model.owners) if owner == 0]
    dynamics = scene.game.players[0].dynamics
    walks = isinstance(dynamics, DoubleIntegrator)
    state, own = np.array([1.0, -2.0, 0.5 if walks else 6.0, 0.5]), OwnState()
    found = []
    for _ in range(steps):
        seen = np.zeros(model.size)
        seen[mine] = state[: len(mine)] + noise * random.normal(size=len(mine))
        if random.uniform() < missing:
            seen[mine] = np.nan
        own = follow_own_state(scene, 0, model, own, seen)
        found.append((state, own.mean, own.covariance))
        action = random.uniform(-0.2, 0.2, 2)
        own = own.acted(action)
        state = np.asarray(_moved(dynamics, state, action)[0])
    return found


@pytest.mark.parametrize("observation", ["full", "positions"])
@pytest.mark.parametrize("make", [parallel_env, driving_env])
def test_it_knows_better_than_any_observation(make, observation):
    scene = scene_of(make, observation)
    errors = []
    for seed in range(5):
        errors += [mean - state for state, mean, _ in drive(scene, 60, seed)[20:]]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[:2].max() < 0.5 * NOISE
    assert rms[2:].max() < NOISE


def test_its_doubt_is_honest():
    """Squared errors in units of the covariance average to the number of entries."""
    scene = scene_of(driving_env, "full")
    distances = []
    for seed in range(30):
        state, mean, covariance = drive(scene, 12, seed)[-1]
        distances.append((mean - state) @ np.linalg.solve(covariance, mean - state))
    assert 2.0 < np.mean(distances) < 6.5  # 4, and its deviation is 0.5


def test_what_is_missing_is_bridged():
    scene = scene_of(driving_env, "full")
    errors = [m - s for s, m, _ in drive(scene, 60, 3, missing=0.6) if m is not None]
    assert np.abs(errors[-30:]).max() < 3.0 * NOISE


def test_without_noise_it_is_the_truth():
    scene = scene_of(driving_env, "full", noise=0.0)
    for state, mean, _ in drive(scene, 20, 0, noise=0.0):
        np.testing.assert_allclose(mean, state, atol=1e-5)
    assert observation_variance(scene) > 0.0


def test_nothing_is_known_before_two_positions():
    scene = scene_of(parallel_env, "positions")
    model = scene.observation_model(0)
    first = follow_own_state(scene, 0, model, OwnState(), np.zeros(model.size))
    assert first.mean is None
    second = follow_own_state(scene, 0, model, first.acted(np.zeros(2)), np.ones(model.size))
    np.testing.assert_allclose(second.mean, [1.0, 1.0, 1.0 / scene.dt, 1.0 / scene.dt])
    lost = follow_own_state(scene, 0, model, first, np.full(model.size, np.nan))
    assert lost.mean is None
    assert lost.seen is None


def test_it_stays_within_the_limits_of_the_state():
    scene = scene_of(driving_env, "full", noise=1.0)
    model = scene.observation_model(0)
    seen = np.zeros(model.size)
    own = follow_own_state(scene, 0, model, OwnState(), seen).acted(np.array([-5.0, 0.0]))
    own = follow_own_state(scene, 0, model, own, seen - 3.0)
    assert own.mean[2] == 0.0


def test_perception_asks_for_an_observation_first():
    scene = scene_of(parallel_env, "full")
    with pytest.raises(ValueError, match="memory: holds no observation yet"):
        Perception(scene, 0).states()


def test_perception_takes_the_own_state_from_what_the_ego_did():
    scene = scene_of(parallel_env, "full")
    size = scene.observation_model(0).size
    seen = Perception(scene, 0).taking(np.zeros(size + 2), {}).acted(np.array([1.0, 0.0]))
    seen = seen.taking(np.zeros(size + 2), {})
    assert seen.states()[0][2] > 0.0  # it accelerated, whatever it sees
    assert seen.states()[1].tolist() == [0.0] * 4
