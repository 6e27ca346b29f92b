"""Inverse problem: from observations to discount factors and cost parameters."""

from foresight_env.inverse.coordinates import Free
from foresight_env.inverse.estimate import Estimate, MultiStart, estimate
from foresight_env.inverse.gauss_newton import GaussNewton
from foresight_env.inverse.gradient_descent import GradientDescent
from foresight_env.inverse.prior import Prior

__all__ = [
    "Estimate",
    "Free",
    "GaussNewton",
    "GradientDescent",
    "MultiStart",
    "Prior",
    "estimate",
]
