"""The conformance tests pass what the library has, and find what is wrong with anything else."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from agents import PREDICTORS, Decision, make_ego, make_predictor
from agents.conformance import (
    ConformanceError,
    check_ego,
    check_predictor,
    context_histories,
    histories,
)
from agents.predictors.kinematic import ConstantVelocityPredictor
from agents.registry import CROSSWALK_EGOS
from foresight_env.envs.crosswalk_v0 import parallel_env

PLAYING = (
    "encounter-game",
    "encounter-game-gamma-1",
    "junction-game",
    "junction-game-gamma-1",
    "kkt-residual",
    "particle-filter",
)
"""Predictors that compile a game for each set of classes and each horizon."""
MORE = {"junction-game": ("a car and a pedestrian", "a car on a route")}
"""Further cases of predictors that read more than positions."""
FEW = (
    "two pedestrians",
    "a single observation",
    "unseen at the end",
    "a crosswalk with its game, a single observation",
)


@pytest.mark.parametrize("name", PREDICTORS)
def test_every_registered_predictor_conforms(name):
    cases = (*histories(), *context_histories())
    few = (*FEW, *MORE.get(name, ()))
    chosen = [(case, h) for case, h in cases if name not in PLAYING or case in few]
    check_predictor(make_predictor(name), chosen)


@pytest.mark.parametrize("name", [*CROSSWALK_EGOS, "kalman+plan"])
def test_every_registered_ego_conforms(name):
    check_ego(make_ego(name), steps=3, blind=name != "oracle")


@dataclass
class Spoiled:
    """Constant velocity, whose forecasts are spoiled by `how`."""

    how: object
    name: str = "spoiled"
    straight: object = field(default_factory=ConstantVelocityPredictor)

    def predict(self, history, steps):
        return self.how(self.straight.predict(history, steps), history)


def replace(found, **changed):
    """As a user's own class may look; the tests' run-time types would refuse a `Forecast`."""
    return SimpleNamespace(**{**vars(found), **changed})


def shuffled(found, history):
    return replace(found, positions=found.positions + np.random.default_rng().random())


def overwritten(found, history):
    history.states[:] = 0.0
    return found


def wide(found, history):
    bent = np.zeros((*found.positions.shape, 2)) + np.array([[1.0, 2.0], [2.0, 1.0]])
    return replace(found, covariance=bent)


SPOILED = {
    "holds NaN": lambda found, history: replace(found, positions=np.nan * found.positions),
    "expected a NumPy array": lambda found, history: replace(found, probabilities=[1.0]),
    r"positions: has shape .* \(M, steps, N, 2\)": lambda found, history: replace(
        found, positions=found.positions[0][:, None]
    ),
    "a sum of 1": lambda found, history: replace(found, probabilities=np.array([0.5])),
    "eigenvalue -1": wide,
    "in the axes of the history": lambda found, history: replace(
        found, positions=found.positions - history.states[-1, :, :2] + 60.0
    ),
    "had another forecast": shuffled,
    "changed the history": overwritten,
    r"gamma: has shape \(1,\)": lambda found, history: replace(found, gamma=np.ones(1)),
}


@pytest.mark.parametrize("told", SPOILED)
def test_what_is_wrong_with_a_predictor_is_told(told):
    check_predictor(Spoiled(lambda found, history: found))
    with pytest.raises(ConformanceError, match=told):
        check_predictor(Spoiled(SPOILED[told]))


def test_an_agent_has_a_name():
    with pytest.raises(ConformanceError, match="name: is ''; expected a text"):
        check_predictor(Spoiled(lambda found, history: found, ""))


class Steady:
    """Half of the greatest acceleration in x, for ever; subclasses do it wrong."""

    name = "steady"

    def init(self, scene, agent):
        return 0

    def update(self, memory, observation, info):
        return memory + 1

    def act(self, memory):
        return Decision(np.array([5.0, 0.0], np.float32)), memory


class TooMuch(Steady):
    def act(self, memory):
        return Decision(np.array([50.0, 0.0], np.float32)), memory


class Forgetful(Steady):
    """Keeps its memory in itself."""

    def __init__(self):
        self.count = 0

    def init(self, scene, agent):
        self.count = 0

    def update(self, memory, observation, info):
        self.count += 1

    def act(self, memory):
        return Decision(np.array([self.count, 0.0], np.float32)), memory


class Peeping(Steady):
    def update(self, memory, observation, info):
        return info["gamma"]

    def act(self, memory):
        return Decision(np.array([0.0 if memory is None else memory[1], 0.0], np.float32)), memory


class Sketchy(Steady):
    def act(self, memory):
        right = vars(Decision(np.zeros(2, np.float32)))
        return SimpleNamespace(**{**right, "planned": np.zeros((3, 4))}), memory


class Mistaken(Steady):
    def act(self, memory):
        return Decision(np.zeros(2, np.float32), gammas={7: (0.5, 0.1)}), memory


WRONG = {
    "action: is .* expected one of Box": TooMuch,
    "two episodes at once": Forgetful,
    "only an oracle may look": Peeping,
    r"planned: has shape \(3, 4\)": Sketchy,
    "gammas: expected a dict by player, 0 to 1": Mistaken,
}


@pytest.mark.parametrize("told", WRONG)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_is_wrong_with_an_ego_is_told(told):
    check_ego(Steady())
    with pytest.raises(ConformanceError, match=told):
        check_ego(WRONG[told]())


def test_any_environment_will_do():
    check_ego(Steady(), lambda: parallel_env(controlled=(1,), planning_horizon=10, players=2))


def test_both_histories_with_and_without_a_context_are_cases():
    without = [h.context for _, h in histories()]
    assert all(c.game is None and not c.routes for c in without)
    contexts = [h.context for _, h in context_histories()]
    assert any(c.routes for c in contexts)
    assert any(c.game is not None for c in contexts)


def test_who_reads_a_context_that_may_be_missing_is_found():
    def reading(found, history):
        return replace(found, positions=found.positions + 0.0 * history.context.routes[0][0, 0])

    with pytest.raises(IndexError):
        check_predictor(Spoiled(reading))
