"""Predictors and ego policies."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from agents.registry import EGOS, PREDICTORS, make_ego, make_predictor

if TYPE_CHECKING:
    from agents.egos.infer_gamma import InferGamma, assume_gamma_1
    from agents.egos.oracle import Oracle
    from agents.egos.predict_then_plan import PredictThenPlan, constant_velocity
    from agents.interfaces.policy import Decision, EgoPolicy
    from agents.interfaces.predictor import (
        Context,
        Forecast,
        FunctionPredictor,
        History,
        Predictor,
        SceneGame,
    )
    from agents.predictors.encounter import EncounterPredictor
    from agents.predictors.junction import JunctionPredictor
    from agents.predictors.kinematic import ConstantTurnRatePredictor, ConstantVelocityPredictor
    from agents.predictors.scene_game import SceneGamePredictor

_MODULES = {
    "ConstantTurnRatePredictor": "predictors.kinematic",
    "ConstantVelocityPredictor": "predictors.kinematic",
    "Context": "interfaces.predictor",
    "Decision": "interfaces.policy",
    "EgoPolicy": "interfaces.policy",
    "EncounterPredictor": "predictors.encounter",
    "Forecast": "interfaces.predictor",
    "FunctionPredictor": "interfaces.predictor",
    "History": "interfaces.predictor",
    "InferGamma": "egos.infer_gamma",
    "JunctionPredictor": "predictors.junction",
    "Oracle": "egos.oracle",
    "PredictThenPlan": "egos.predict_then_plan",
    "Predictor": "interfaces.predictor",
    "SceneGame": "interfaces.predictor",
    "SceneGamePredictor": "predictors.scene_game",
    "assume_gamma_1": "egos.infer_gamma",
    "constant_velocity": "egos.predict_then_plan",
}

__all__ = [
    "EGOS",
    "PREDICTORS",
    "ConstantTurnRatePredictor",
    "ConstantVelocityPredictor",
    "Context",
    "Decision",
    "EgoPolicy",
    "EncounterPredictor",
    "Forecast",
    "FunctionPredictor",
    "History",
    "InferGamma",
    "JunctionPredictor",
    "Oracle",
    "PredictThenPlan",
    "Predictor",
    "SceneGame",
    "SceneGamePredictor",
    "assume_gamma_1",
    "constant_velocity",
    "make_ego",
    "make_predictor",
]


def __getattr__(name: str) -> Any:
    # On demand: names of agents can be listed without loading JAX.
    if name in _MODULES:
        return getattr(import_module(f"agents.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
