"""Egos and predictors by name, for the command line and the studies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agents.constant_velocity import ConstantVelocity
from agents.encounter_predictor import EncounterPredictor
from agents.foresight import Foresight, farsighted
from agents.idm_predictor import IdmPredictor
from agents.kalman import KalmanPredictor
from agents.kinematic import (
    ConstantTurnRateAccelerationPredictor,
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
)
from agents.kkt_residual import KktResidualPredictor
from agents.oracle import Oracle
from agents.orca import OrcaPredictor
from agents.particle_filter import ParticleFilterPredictor
from agents.policy import EgoPolicy
from agents.predictor import Predictor
from agents.social_force import SocialForcePredictor

EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    "oracle": Oracle,
    "foresight": Foresight,
    "farsighted": farsighted,
    "constant-velocity": ConstantVelocity,
}


def _idm() -> EgoPolicy[Any]:
    from agents.idm import Idm  # loads highway-env, which the other egos do without

    return Idm()


DRIVING_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {**EGOS, "idm": _idm}
"""All egos; those beyond `EGOS` drive cars along paths only."""


def make_ego(name: str) -> EgoPolicy[Any]:
    """The registered ego of that name; `ValueError` lists the names."""
    if name not in DRIVING_EGOS:
        raise ValueError(f"ego: {name!r} is unknown; choose from {', '.join(DRIVING_EGOS)}")
    return DRIVING_EGOS[name]()


PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "foresight": EncounterPredictor,
    "farsighted": lambda: EncounterPredictor(infer=False),
    "kkt-residual": KktResidualPredictor,
    "particle-filter": ParticleFilterPredictor,
    "constant-velocity": ConstantVelocityPredictor,
    "constant-turn-rate": ConstantTurnRatePredictor,
    "constant-acceleration": ConstantTurnRateAccelerationPredictor,
    "kalman": KalmanPredictor,
    "social-force": SocialForcePredictor,
    "orca": OrcaPredictor,
    "idm": IdmPredictor,
}


def make_predictor(name: str) -> Predictor:
    """The registered predictor of that name; `ValueError` lists the names."""
    if name not in PREDICTORS:
        raise ValueError(f"predictor: {name!r} is unknown; choose from {', '.join(PREDICTORS)}")
    return PREDICTORS[name]()
