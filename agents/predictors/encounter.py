"""The encounter game as a predictor: inferred discount factors and preferred motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from agents.predictors.encounter_fit import (
    EncounterBelief,
    preferred_motion,
    seen_states,
)
from agents.predictors.equilibrium_forecast import (
    LEAST_STEPS,
    equilibrium_forecast,
    straight_on,
    wandering,
)
from foresight_env.games import full_state
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse import Estimate, Free, MultiStart, Prior, estimate, guess_initial_state
from foresight_env.scenarios.encounter import encounter_game, player_theta


@dataclass(frozen=True)
class EncounterPredictor:
    """Fit of the encounter game to the history; its equilibrium is the forecast."""

    infer: bool = True
    """Whether discount factors are inferred; else they are 1."""
    noise_std: float = 0.03
    """Standard deviation of the latest positions, velocities and headings (m, m/s, rad)."""
    forgetting_factor: float = 1.8
    """By how much the deviation grows per step into the past: people change their minds, so old
    observations say less of what they want now."""
    belief: EncounterBelief = EncounterBelief()
    starts: int = 4

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return "encounter-game" if self.infer else "encounter-game-gamma-1"

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; constant velocity as a fallback where no fit succeeds.

        A single observation is nothing to fit to.
        """
        if len(history.states) < LEAST_STEPS:
            return straight_on(history, steps)
        found = self.fit(history, steps)
        departures = wandering(
            self.belief.walking_wander, self.belief.driving_wander, history, steps
        )
        return equilibrium_forecast(found, history, steps, departures)

    def fit(self, history: History, steps: int) -> Estimate:
        """The estimate behind the forecast: it covers the history and `steps` more."""
        known = len(history.states)
        game = encounter_game(history.kinds, known - 1 + steps, history.dt)
        model = full_state(game.state_sizes)
        driving = [is_vehicle(kind) for kind in history.kinds]
        observations = seen_states(history).reshape(known, -1)
        free = [
            Free(("speed", "curvature") if drives else ("velocity",), self.infer, True)
            for drives in driving
        ]
        beliefs = [self.belief.gamma(kind) for kind in history.kinds]
        return estimate(
            game,
            observations,
            model,
            initial_state=guess_initial_state(game, model, observations),
            theta=[
                player_theta(k, preferred_motion(history, i)) for i, k in enumerate(history.kinds)
            ],
            gamma=[center if self.infer else 1.0 for center, _ in beliefs],
            free=free,
            covariance=self._covariance(known, observations.shape[1]),
            prior=Prior(
                tuple(weight for _, weight in beliefs),
                tuple(center for center, _ in beliefs),
                self._deviations(driving),
            ),
            starts=MultiStart(self.starts),
        )

    def _covariance(self, known: int, size: int) -> Float[np.ndarray, "K size size"]:
        """Covariance per observation, newest last."""
        deviation = self.noise_std * self.forgetting_factor ** np.arange(known - 1, -1, -1)
        return deviation[:, None, None] ** 2 * np.eye(size)

    def _deviations(self, driving: list[bool]) -> tuple[tuple[str, float], ...]:
        """Deviations of preferred motion, of the kinds of agents that there are."""
        belief = self.belief
        walking = (("velocity", belief.velocity_deviation),)
        steered = (("speed", belief.speed_deviation), ("curvature", belief.curvature_deviation))
        return (() if all(driving) else walking) + (steered if any(driving) else ())
