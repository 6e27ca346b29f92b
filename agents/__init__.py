"""Predictors and ego policies."""

from agents.constant_velocity import ConstantVelocity
from agents.encounter_predictor import EncounterPredictor
from agents.foresight import Foresight, farsighted
from agents.kinematic import ConstantTurnRatePredictor, ConstantVelocityPredictor
from agents.oracle import Oracle
from agents.policy import Decision, EgoPolicy
from agents.predictor import Forecast, History, Predictor
from agents.registry import EGOS, PREDICTORS, make_ego, make_predictor

__all__ = [
    "EGOS",
    "PREDICTORS",
    "ConstantTurnRatePredictor",
    "ConstantVelocity",
    "ConstantVelocityPredictor",
    "Decision",
    "EgoPolicy",
    "EncounterPredictor",
    "Forecast",
    "Foresight",
    "History",
    "Oracle",
    "Predictor",
    "farsighted",
    "make_ego",
    "make_predictor",
]
