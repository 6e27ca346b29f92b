"""Predictors and ego policies."""

from agents.egos.foresight import Foresight, farsighted
from agents.egos.oracle import Oracle
from agents.egos.predict_then_plan import PredictThenPlan, constant_velocity
from agents.interfaces.policy import Decision, EgoPolicy
from agents.interfaces.predictor import Forecast, FunctionPredictor, History, Predictor
from agents.predictors.encounter import EncounterPredictor
from agents.predictors.kinematic import ConstantTurnRatePredictor, ConstantVelocityPredictor
from agents.registry import EGOS, PREDICTORS, make_ego, make_predictor

__all__ = [
    "EGOS",
    "PREDICTORS",
    "ConstantTurnRatePredictor",
    "ConstantVelocityPredictor",
    "Decision",
    "EgoPolicy",
    "EncounterPredictor",
    "Forecast",
    "Foresight",
    "FunctionPredictor",
    "History",
    "Oracle",
    "PredictThenPlan",
    "Predictor",
    "constant_velocity",
    "farsighted",
    "make_ego",
    "make_predictor",
]
