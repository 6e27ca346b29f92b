"""Inverse problem: from observations to discount factors and cost parameters."""

from foresight_env.inverse.arrival_cost import ProcessNoise
from foresight_env.inverse.bound import CramerRao, cramer_rao
from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.estimate import estimate
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent
from foresight_env.inverse.initial import NeverSeenError, guess_initial_state
from foresight_env.inverse.linear_step import Rates
from foresight_env.inverse.moving_horizon import MovingHorizonEstimator, MovingHorizonState
from foresight_env.inverse.multi_start import MultiStart
from foresight_env.inverse.parameter import Parameter
from foresight_env.inverse.posterior import Posterior, PosteriorMean
from foresight_env.inverse.prior import Prior
from foresight_env.inverse.profile import Profile
from foresight_env.inverse.result import Estimate
from foresight_env.inverse.update_phases import UpdatePhase

__all__ = [
    "CramerRao",
    "Estimate",
    "Free",
    "GaussNewton",
    "GradientDescent",
    "MovingHorizonEstimator",
    "MovingHorizonState",
    "MultiStart",
    "NeverSeenError",
    "Parameter",
    "Posterior",
    "PosteriorMean",
    "Prior",
    "ProcessNoise",
    "Profile",
    "Rates",
    "UpdatePhase",
    "cramer_rao",
    "estimate",
    "guess_initial_state",
]
