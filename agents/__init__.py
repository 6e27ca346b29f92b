"""Predictors and ego policies."""

from agents.constant_velocity import ConstantVelocity
from agents.foresight import Foresight, farsighted
from agents.oracle import Oracle
from agents.policy import Decision, EgoPolicy
from agents.registry import EGOS, make_ego

__all__ = [
    "EGOS",
    "ConstantVelocity",
    "Decision",
    "EgoPolicy",
    "Foresight",
    "Oracle",
    "farsighted",
    "make_ego",
]
