"""Inverse game by residual minimisation, as a predictor.

All agents' first-order conditions are written down at the observed trajectory, as if it were the
equilibrium itself, and the parameters are chosen that violate them least (Awasthi and
Lamperski, "Inverse differential games with mixed inequality constraints", ACC 2020; Rothfuss et
al., "Inverse optimal control for identification in non-cooperative differential games", IFAC 2017).
That needs no forward solve, but the whole state at every step, and noise enters as if it were
intention.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from agents.interfaces.predictor import Forecast, History
from agents.predictors.encounter_fit import (
    LEAST_SPEED,
    EncounterBelief,
    filled_states,
    preferred_motion,
)
from agents.predictors.kinematic import ConstantVelocityPredictor
from foresight_env.equilibrium import Status, solve
from foresight_env.games import stage_cost
from foresight_env.games.kinds import is_vehicle
from foresight_env.precision import in_double_precision
from foresight_env.scenarios.encounter import (
    CURVATURE_LIMIT,
    encounter_game,
    player_theta,
)

BARELY = 1e-6
"""How far from their limits searches begin, as the solver asks for."""


@dataclass(frozen=True)
class KktResidualPredictor:
    """Parameters of least residual; their equilibrium is the forecast."""

    name: str = "kkt-residual"
    residual_std: float = 0.3
    """Standard deviation that the derivatives of the costs by the controls are believed to have
    (m/s^2, the scale of the cost of accelerations); the prior has weight relative to it."""
    belief: EncounterBelief = EncounterBelief()

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; constant velocity as a fallback where the game is not solved."""
        count = len(history.kinds)
        states = filled_states(history)
        found = [self._fit(history, states, i) for i in range(count)]
        gamma = np.array([values[0] for values in found])
        theta = [player_theta(k, found[i][1:3]) for i, k in enumerate(history.kinds)]
        game = encounter_game(history.kinds, steps, history.dt)
        solution = solve(game, list(states[-1]), theta, gamma)
        if int(solution.status) != Status.SOLVED:
            straight = ConstantVelocityPredictor().predict(history, steps)
            return Forecast(straight.positions, straight.probabilities, fallback=True)
        paths = np.stack([s[1:, :2] for s in solution.states], axis=1)
        return Forecast(paths[None], np.ones(1), gamma=gamma)

    def _fit(
        self, history: History, states: Float[np.ndarray, "K N 4"], agent: int
    ) -> Float[np.ndarray, "7"]:
        """Discount factor, preferred motion and value of the last state (a costate) of an agent."""
        kind = history.kinds[agent]
        center, _ = self.belief.gamma(kind)
        preferred = np.asarray(preferred_motion(history, agent), dtype=float)
        start = np.array([center, *preferred, 0.0, 0.0, 0.0, 0.0])
        deviations = [self.belief.gamma_deviation(kind), *self.belief.wish_deviation(kind)]
        precision = 1.0 / np.array(deviations)
        if len(states) < 2:
            return start
        shape = (history.kinds, history.dt, agent)
        seen = ~np.isnan(history.states[:, agent]).any(axis=1)
        counted = np.repeat(seen[1:] & seen[:-1], 2)

        def residual(values: np.ndarray) -> np.ndarray:
            slopes, _ = _conditions(*shape, states, values)
            believed = precision * (values[:3] - start[:3])
            return np.concatenate([np.asarray(slopes)[counted] / self.residual_std, believed])

        def jacobian(values: np.ndarray) -> np.ndarray:
            _, rates = _conditions(*shape, states, values)
            believed = np.column_stack([np.diag(precision), np.zeros((3, 4))])
            return np.vstack([np.asarray(rates)[counted] / self.residual_std, believed])

        low, high = np.full(7, -np.inf), np.full(7, np.inf)
        low[0], high[0] = 0.0, 1.0
        if is_vehicle(kind):
            low[1] = 0.0
            low[2], high[2] = -CURVATURE_LIMIT, CURVATURE_LIMIT
        begin = np.clip(start, low + BARELY, high - BARELY)
        return np.asarray(least_squares(residual, begin, jacobian, (low, high)).x)


@in_double_precision
@partial(jax.jit, static_argnums=(0, 1, 2))
def _conditions(
    kinds: tuple[str, ...],
    dt: float,
    agent: int,
    states: Float[Array, "K N 4"],
    values: Float[Array, "7"],
) -> tuple[Float[Array, "r"], Float[Array, "r 7"]]:
    """Derivatives of an agent's Lagrangian by its controls, and theirs by the parameters.

    What lies after the last observation is not known: its value is linear in the last state, with
    an unknown costate.
    """
    horizon = states.shape[0] - 1
    game = encounter_game(kinds, horizon, dt)
    dynamics = game.players[agent].dynamics
    controls = jnp.stack([_controls(k, dt, states[:, j]) for j, k in enumerate(kinds)], axis=1)

    def lagrangian(own: Array, values: Array) -> Array:
        theta = player_theta(kinds[agent], values[1:3])
        state, total = states[0, agent], jnp.zeros(())
        for t in range(horizon):
            # What the dynamics do not explain is added: the path is the one that was seen.
            gap = states[t + 1, agent] - dynamics(t + 1, states[t, agent], controls[t, agent])
            state = dynamics(t + 1, state, own[t]) + gap
            x, u = list(states[t + 1]), list(controls[t])
            x[agent], u[agent] = state, own[t]
            discounted, undiscounted = stage_cost(game, agent, t + 1, tuple(x), tuple(u), theta)
            total += values[0] ** t * discounted + undiscounted
        return total + values[3:] @ state

    def conditions(values: Array) -> Array:
        return jax.grad(lagrangian)(controls[:, agent], values).reshape(-1)

    return conditions(values), jax.jacfwd(conditions)(values)


def _controls(kind: str, dt: float, states: Float[Array, "K 4"]) -> Float[Array, "T 2"]:
    """Accelerations of people, acceleration and curvature of vehicles, between two states each."""
    change = jnp.diff(states, axis=0)
    if not is_vehicle(kind):
        return change[:, 2:] / dt
    passed = jnp.maximum(0.5 * (states[1:, 2] + states[:-1, 2]), LEAST_SPEED) * dt
    return jnp.stack([change[:, 2] / dt, change[:, 3] / passed], axis=1)
