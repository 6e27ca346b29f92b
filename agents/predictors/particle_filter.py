"""Particle filter over discount factors and preferred motion, as a predictor.

Particles are parameters; those whose equilibria predict the next observations are kept (sequential
importance resampling: Gordon, Salmond, Smith, 1993; for games: Peters et al., "Inference-based
strategy alignment for general-sum differential games", AAMAS 2020). Each agent's particles are
weighted and resampled by themselves: jointly, some dozens of them would be lost in a dozen
dimensions (Ng, Peshkin, Pfeffer, "Factored particles for scalable monitoring", UAI 2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import Forecast, History
from agents.predictors.encounter_fit import (
    EncounterBelief,
    filled_states,
    preferred_motion,
)
from agents.predictors.equilibrium_forecast import wandering
from agents.predictors.kinematic import ConstantVelocityPredictor
from foresight_env.equilibrium import Solution, Status, solve_many
from foresight_env.games.kinds import is_vehicle
from foresight_env.scenarios.encounter import (
    CURVATURE_LIMIT,
    encounter_game,
    player_theta,
)


class _Particles(NamedTuple):
    """Particles of all agents' parameters."""

    gamma: Float[np.ndarray, "B N"]
    preferred: Float[np.ndarray, "B N 2"]


@dataclass(frozen=True)
class ParticleFilterPredictor:
    """Particles that play the encounter game from step to step; their mean predicts."""

    name: str = "particle-filter"
    particles: int = 64
    noise_std: float = 0.1
    """Standard deviation of what is seen from what a particle predicts for it (m, m/s, rad)."""
    jitter: float = 0.2
    """By how much of the prior's deviations resampled particles are moved: without it all would
    soon be copies of a few."""
    belief: EncounterBelief = EncounterBelief()
    seed: int = 0

    def predict(self, history: History, steps: int) -> Forecast:
        """Return the forecast; constant velocity as a fallback where no game is solved."""
        random = np.random.default_rng(self.seed)
        states = filled_states(history)
        seen = ~np.isnan(history.states).any(axis=2)
        particles = self._drawn(history, random)
        for k in range(len(states) - 1):
            found = self._played(history, particles, states[k], steps)
            solved = np.asarray(found.status) == Status.SOLVED
            for i in np.flatnonzero(seen[k] & seen[k + 1] & solved.any()):
                error = np.asarray(found.states[i])[:, 1] - states[k + 1, i]
                unlikely = 0.5 * np.sum((error / self.noise_std) ** 2, axis=1)
                unlikely = np.where(solved, unlikely, np.inf)
                weights = np.exp(-(unlikely - unlikely.min()))
                particles = self._resampled(history, int(i), particles, weights, random)
        found = self._played(history, particles, states[-1], steps)
        solved = np.asarray(found.status) == Status.SOLVED
        if not solved.any():
            straight = ConstantVelocityPredictor().predict(history, steps)
            return Forecast(straight.positions, straight.probabilities, fallback=True)
        paths = np.stack([np.asarray(s)[solved, 1:, :2] for s in found.states], axis=2)
        mean = paths.mean(axis=0)
        away = paths - mean
        covariance = np.einsum("btna,btnc->tnac", away, away) / len(paths)
        covariance = covariance + wandering(
            self.belief.walking_wander, self.belief.driving_wander, history, steps
        )
        gamma = particles.gamma[solved]
        return Forecast(
            mean[None], np.ones(1), covariance[None], gamma.mean(axis=0), gamma.std(axis=0)
        )

    def _beliefs(
        self, history: History
    ) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"], Float[np.ndarray, "N 2"]]:
        """Centres and deviations of discount factors, deviations of preferred motion."""
        centers = [self.belief.gamma(kind)[0] for kind in history.kinds]
        deviations = [self.belief.gamma_deviation(kind) for kind in history.kinds]
        wishes = np.stack([self.belief.wish_deviation(kind) for kind in history.kinds])
        return np.array(centers), np.array(deviations), wishes

    def _drawn(self, history: History, random: np.random.Generator) -> _Particles:
        """Particles of the prior."""
        center, deviation, spread = self._beliefs(history)
        count = len(history.kinds)
        preferred = np.stack([preferred_motion(history, i) for i in range(count)])
        drawn = random.standard_normal((self.particles, count, 3))
        away = np.stack([_turned(history, i, drawn[:, i, 1:]) for i in range(count)], axis=1)
        return _inside(
            history, _Particles(center + deviation * drawn[..., 0], preferred + spread * away)
        )

    def _resampled(
        self,
        history: History,
        agent: int,
        particles: _Particles,
        weights: Float[np.ndarray, "B"],
        random: np.random.Generator,
    ) -> _Particles:
        """One agent's particles, systematically resampled and moved a little (Kitagawa, 1996)."""
        _, deviation, spread = self._beliefs(history)
        places = (random.random() + np.arange(self.particles)) / self.particles
        chosen = np.searchsorted(np.cumsum(weights / weights.sum()), places)
        chosen = np.minimum(chosen, self.particles - 1)
        moved = self.jitter * random.standard_normal((self.particles, 3))
        gamma, preferred = particles.gamma.copy(), particles.preferred.copy()
        gamma[:, agent] = gamma[chosen, agent] + deviation[agent] * moved[:, 0]
        away = _turned(history, agent, moved[:, 1:])
        preferred[:, agent] = preferred[chosen, agent] + spread[agent] * away
        return _inside(history, _Particles(gamma, preferred))

    def _played(
        self,
        history: History,
        particles: _Particles,
        states: Float[np.ndarray, "N 4"],
        steps: int,
    ) -> Solution:
        """Each particle's equilibrium from these states."""
        game = encounter_game(history.kinds, steps, history.dt)
        theta: list[tuple[dict[str, Any], ...]] = [
            tuple(player_theta(kind, row[i]) for i, kind in enumerate(history.kinds))
            for row in particles.preferred
        ]
        start = np.broadcast_to(states, (self.particles, *states.shape))
        return solve_many(game, start, theta, particles.gamma)


def _turned(
    history: History, agent: int, drawn: Float[np.ndarray, "B 2"]
) -> Float[np.ndarray, "B 2"]:
    """People's deviations along and across their way, in the axes of the plane.

    Else what is predicted would depend on where north is.
    """
    if is_vehicle(history.kinds[agent]):
        return drawn
    along = preferred_motion(history, agent)
    speed = float(np.hypot(*along))
    cos, sin = along / speed if speed > 0.0 else (1.0, 0.0)
    return drawn @ np.array([[cos, sin], [-sin, cos]])


def _inside(history: History, particles: _Particles) -> _Particles:
    """Discount factors in [0, 1], speeds not below 0, curvatures that the game allows."""
    preferred = particles.preferred.copy()
    for i, kind in enumerate(history.kinds):
        if is_vehicle(kind):
            inside = 0.9 * CURVATURE_LIMIT
            preferred[:, i, 0] = np.maximum(preferred[:, i, 0], 0.0)
            preferred[:, i, 1] = np.clip(preferred[:, i, 1], -inside, inside)
    return _Particles(np.clip(particles.gamma, 0.0, 1.0), preferred)
