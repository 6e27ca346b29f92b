"""From a fitted game to a forecast: positions at its equilibrium, and how certain they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from agents.interfaces.predictor import Forecast, History
from agents.predictors.kinematic import ConstantVelocityPredictor
from foresight_env.equilibrium import Status
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse import Estimate

IMPLAUSIBLE = 30.0
"""Squared deviations per observed number beyond which a fit explains nothing: good ones leave about
one half, a search that was lost hundreds."""
LEAST_STEPS = 2
"""Observations that a fit needs."""


def straight_on(history: History, steps: int) -> Forecast:
    """Return the forecast of constant velocity, marked as a fallback."""
    straight = ConstantVelocityPredictor().predict(history, steps)
    return Forecast(straight.positions, straight.probabilities, fallback=True)


def equilibrium_forecast(
    found: Estimate, history: History, steps: int, departures: Float[np.ndarray, "P N 2 2"]
) -> Forecast:
    """Return the forecast of a fit that covers the history and `steps` more.

    Args:
        found: The fit.
        history: What it was made of.
        steps: P.
        departures: Covariance of agents' departures from the equilibrium, m^2; that of the
            uncertain parameters is added.

    Returns:
        The equilibrium's positions; constant velocity as a fallback where the fit failed or
        explains nothing.
    """
    numbers = np.count_nonzero(~np.isnan(history.states))
    if int(found.status) != Status.SOLVED or found.cost > IMPLAUSIBLE * numbers:
        return straight_on(history, steps)
    future = slice(len(history.states), None)
    path = np.stack([s[future, :2] for s in found.solution.states], axis=1)
    return Forecast(
        path[None],
        np.ones(1),
        (covariance_of(found, future) + departures)[None],
        found.gamma,
        found.gamma_deviation,
        found.gamma_identifiable,
    )


def from_where_seen(forecast: Forecast, found: Estimate, history: History) -> Forecast:
    """Return the forecast moved so that it begins where each agent was seen last.

    The fit is a compromise between all observations; what it is off at the last one, it is off
    later, and a path that jumps there is none that a car can take.
    """
    if forecast.fallback:
        return forecast
    last = [int(history.seen(i)[-1]) for i in range(len(history.kinds))]
    off = np.stack(
        [history.states[k, i, :2] - found.solution.states[i][k, :2] for i, k in enumerate(last)]
    )
    return replace(forecast, positions=forecast.positions + off)


def covariance_of(
    found: Estimate, rows: slice | Int[np.ndarray, "P"]
) -> Float[np.ndarray, "P N 2 2"]:
    """Covariance (m^2) that the uncertain parameters leave of positions in rows of the states."""
    rates = found.state_jacobian[rows]
    begins = np.cumsum([0, *(s.shape[1] for s in found.solution.states)])[:-1]
    blocks = [rates[:, b : b + 2] for b in begins]
    return np.stack([np.einsum("tap,pq,tbq->tab", j, found.covariance, j) for j in blocks], axis=1)


def wandering(
    walking: float, driving: float, history: History, steps: int
) -> Float[np.ndarray, "P N 2 2"]:
    """Covariance of agents' departures from the equilibrium after 1..P steps, m^2.

    White acceleration, integrated twice (Bar-Shalom et al., "Estimation with Applications to
    Tracking and Navigation", 2001, section 6.2). `walking`, `driving`: its density, m^2/s^3.
    """
    density = [driving if is_vehicle(kind) else walking for kind in history.kinds]
    times = history.dt * np.arange(1, steps + 1)
    return np.asarray(np.multiply.outer(np.outer(times**3 / 3.0, density), np.eye(2)))
