"""Predictors and ego policies."""

from agents.encounter_predictor import EncounterPredictor
from agents.foresight import Foresight, farsighted
from agents.kinematic import ConstantTurnRatePredictor, ConstantVelocityPredictor
from agents.oracle import Oracle
from agents.policy import Decision, EgoPolicy
from agents.predict_then_plan import PredictThenPlan, constant_velocity
from agents.predictor import Forecast, FunctionPredictor, History, Predictor
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
