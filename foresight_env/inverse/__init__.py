"""Inverse problem: from observations to discount factors and cost parameters."""

from foresight_env.inverse.bound import CramerRao, cramer_rao
from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.estimate import Estimate, estimate
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent
from foresight_env.inverse.initial import NeverSeenError, guess_initial_state
from foresight_env.inverse.linear_step import Rates
from foresight_env.inverse.moving_horizon import (
    MovingHorizonEstimator,
    MovingHorizonState,
    ProcessNoise,
)
from foresight_env.inverse.multi_start import MultiStart
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.profile import Profile

__all__ = [
    "CramerRao",
    "ProcessNoise",
    "Estimate",
    "Free",
    "GaussNewton",
    "GradientDescent",
    "MultiStart",
    "NeverSeenError",
    "MovingHorizonEstimator",
    "MovingHorizonState",
    "Prior",
    "Profile",
    "Rates",
    "cramer_rao",
    "estimate",
    "guess_initial_state",
]
