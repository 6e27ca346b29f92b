"""Agents by name, by module, and with the planner."""

import numpy as np
import pytest

from agents import FunctionPredictor, PredictThenPlan, make_ego, make_predictor
from agents.egos.idm import Idm
from agents.predictors.kalman import KalmanPredictor
from agents.predictors.kinematic import ConstantVelocityPredictor
from agents.registry import ALL_EGOS, ALL_PREDICTORS

SOURCE = """
from agents.predictors.kalman import KalmanPredictor
from agents.egos.idm import Idm
import numpy as np

ready = KalmanPredictor(name="ready")

def standing(history, steps):
    last = np.stack([history.states[history.seen(i)[-1], i, :2] for i in range(len(history.kinds))])
    return np.broadcast_to(last, (steps, *last.shape))

def made(name="made"):
    return KalmanPredictor(name=name)

class Own(KalmanPredictor):
    pass

class Weighted(KalmanPredictor):
    def __new__(cls, weights=None):
        return KalmanPredictor(name=f"weighted {weights}")

class Needy:
    def __init__(self, path):
        pass

number = 3
"""


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "own_agents.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)


def test_objects_classes_and_functions_of_a_module():
    assert make_predictor("own_agents:ready").name == "ready"
    assert make_predictor("own_agents:made").name == "made"
    assert isinstance(make_predictor("own_agents:Own"), KalmanPredictor)
    assert isinstance(make_ego("own_agents:Idm"), Idm)


def test_a_function_of_a_history_is_a_predictor():
    found = make_predictor("own_agents:standing")
    assert isinstance(found, FunctionPredictor)
    assert found.name == "standing"


def test_weights_from_a_folder(tmp_path):
    """A network reads its file there; a class of a module gets the folder if it takes it."""
    with pytest.raises(ValueError, match=r"social-lstm.safetensors: is missing; train social-lstm"):
        make_predictor("social-lstm", tmp_path)
    (tmp_path / "social-lstm.safetensors").write_bytes(b"")
    made = make_predictor("social-lstm", tmp_path)
    assert made.weights == str(tmp_path / "social-lstm.safetensors")
    assert make_predictor("own_agents:Weighted", tmp_path).name == f"weighted {tmp_path}"
    assert make_predictor("own_agents:Weighted").name == "weighted None"
    assert make_predictor("own_agents:made", tmp_path).name == "made"
    assert make_predictor("own_agents:ready", tmp_path).name == "ready"
    assert make_predictor("kalman", tmp_path) == make_predictor("kalman")


def test_any_predictor_can_be_planned_with():
    ego = make_ego("own_agents:standing+plan")
    assert isinstance(ego, PredictThenPlan)
    assert ego.name == "standing+plan"
    assert isinstance(ego.predictor, FunctionPredictor)
    assert isinstance(make_ego("kalman+plan").predictor, KalmanPredictor)
    assert isinstance(make_ego("constant-velocity").predictor, ConstantVelocityPredictor)


@pytest.mark.parametrize("name", [*ALL_EGOS, *(f"{name}+plan" for name in ALL_PREDICTORS)])
def test_an_ego_has_the_name_that_it_is_registered_by(name):
    assert make_ego(name).name == name


@pytest.mark.parametrize("name", ALL_PREDICTORS)
def test_a_predictor_has_the_name_that_it_is_registered_by(name):
    assert make_predictor(name).name == name


@pytest.mark.parametrize(
    ("make", "name", "told"),
    [
        (make_predictor, "nowhere:Net", "'nowhere' cannot be imported"),
        (make_predictor, "own_agents:Missing", "'own_agents' has no 'Missing'"),
        (make_predictor, "own_agents:number", "is a int; expected something with name and predict"),
        (make_ego, "own_agents:ready", "expected something with name, init, update and act"),
        (make_predictor, "magic", "predictor: 'magic' is unknown; choose from hybrid-game"),
        (make_ego, "magic", "ego: 'magic' is unknown; choose from oracle"),
        (make_ego, "magic+plan", "predictor: 'magic' is unknown"),
        (make_predictor, "own_agents:Needy", "cannot be made without arguments"),
    ],
)
def test_what_is_wrong_is_told(make, name, told):
    with pytest.raises(ValueError, match=told):
        make(name)


def test_a_function_may_return_positions_or_a_whole_forecast():
    one = FunctionPredictor(lambda history, steps: np.zeros((steps, 1, 2)), "one")
    other = FunctionPredictor(lambda history, steps: one.predict(history, steps), "other")
    from agents.conformance import histories

    history = dict(histories())["one agent"]
    for predictor in (one, other):
        found = predictor.predict(history, 3)
        assert found.positions.shape == (1, 3, 1, 2)
        assert found.probabilities.tolist() == [1.0]
