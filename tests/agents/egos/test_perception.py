"""Positions of all agents, hidden ones included."""

import numpy as np
import pytest

from agents.egos.perception import Perception
from agents.egos.predict_then_plan import PredictThenPlan
from foresight_env.scenarios.crosswalk import DT
from tests.support.small_crossings import crossing

VELOCITY = np.array([0.3, -0.2])
START = np.array([0.5, 1.5])
OTHER = 1


def truth(k):
    return np.concatenate([START + k * DT * VELOCITY, VELOCITY])


def observation(size, k, shown, goal=(0.0, 0.0)):
    """Observation without noise of two people, the ego standing still."""
    other = truth(k)[:size] if shown else np.full(size, np.nan)
    return np.concatenate([np.zeros(size), other, goal])


def watched(observed, seen, steps):
    """The perception after each step; the other is shown at the steps in `seen`."""
    env = crossing(observation=observed)
    env.reset(seed=0)
    size, found = {"full": 4, "positions": 2}[observed], []
    perception = Perception(env.scene, 0)
    for k in range(steps):
        perception = perception.taking(observation(size, k, k in seen), {})
        found.append(perception)
    return found


@pytest.mark.parametrize("observed", ["full", "positions"])
@pytest.mark.parametrize("gap", [1, 3, 4, 5, 9])
def test_who_is_out_of_sight_goes_straight_on(observed, gap):
    """As long as it is hidden, and no worse once it is seen again."""
    hidden = range(3, 3 + gap)
    found = watched(observed, set(range(20)) - set(hidden), 16)
    for k in range(1, 16):
        np.testing.assert_allclose(found[k].known[OTHER], truth(k), atol=1e-9)


@pytest.mark.parametrize("observed", ["full", "positions"])
def test_who_is_seen_late_has_no_past(observed):
    found = watched(observed, range(4, 20), 8)
    assert [p.missing for p in found] == [True] * 4 + [False] * 4
    # Of the ego at first, of the other when it appears.
    guessed = {0, 4} if observed == "positions" else set()
    assert [p.guessed for p in found] == [k in guessed for k in range(8)]


def test_a_place_without_a_velocity_is_no_track():
    """Histories for predictors have no agent at rest only because it was just observed."""
    env = crossing(observation="positions")
    env.reset(seed=0)
    policy = PredictThenPlan()
    memory = policy.init(env.scene, env.agents[0])
    goal = env.scene.own(0).theta["goal"]
    for k in range(7):
        memory = policy.update(memory, observation(2, k, k >= 3, goal), {})
    assert len(memory.track) == 3
    for k, states in zip(range(4, 7), memory.track, strict=True):
        np.testing.assert_allclose(states[OTHER], truth(k), atol=1e-9)
