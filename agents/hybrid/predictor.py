"""`hybrid-game` as a predictor, and the parameters behind its most likely future."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from agents.hybrid.futures import GameUse, JointFutures, deviations, joint_futures
from agents.hybrid.network import LEAST_GAMMA, ProposalNetwork
from agents.hybrid.scene import Scene, scene_of
from agents.hybrid.smooth_game import interactions, positions
from agents.hybrid.strategies import GAME_BASIS, strategy_basis
from agents.interfaces.predictor import Forecast, History
from agents.learned.features import AGENTS
from agents.learned.weights import FOLDER, load_network
from agents.predictors.kinematic import ConstantVelocityPredictor

NAME = "hybrid-game"
SIMULATED = "simulated"
"""Folder of the weights that have learned from episodes."""
PLACES = (2, 4, AGENTS)
"""Numbers of places for agents that programs are compiled for."""
IDENTIFIED = 0.5
"""A discount factor is identifiable where the window leaves at most this part of the prior's
standard deviation."""


GameBetween = Literal["infer-gamma", "assume-gamma-1", "none"]
USES: dict[str, tuple[str, GameUse]] = {
    "infer-gamma": (NAME, GameUse()),
    "assume-gamma-1": (f"{NAME}-gamma-1", GameUse(infer=False)),
    "none": ("hybrid-network", GameUse(game=False)),
}
"""Predictors' names and what they make of the network's proposals."""


class Explanation(NamedTuple):
    """Parameters behind the most likely future of N agents."""

    goals: Float[np.ndarray, "N 2"]
    """Positions at the end without the others, m."""
    gamma: Float[np.ndarray, "N"]
    """Discount factors per second."""
    gamma_interval: Float[np.ndarray, "N 2"]
    """90 % intervals."""
    interact: Bool[np.ndarray, "N N"]
    """Agents that give way: i pays for coming close to j."""
    solved: bool
    """Whether the future is an equilibrium; else it is the network's proposal."""
    solved_share: float
    """Of all futures."""


@lru_cache(maxsize=16)
def _loaded(path: Path) -> tuple[ProposalNetwork, dict[str, Any]]:
    return load_network(path, lambda about: ProposalNetwork(key=jax.random.key(0)))


@eqx.filter_jit
def _futures(network: ProposalNetwork, scene: Scene, use: GameUse) -> JointFutures:
    return joint_futures(network, scene, use)


@dataclass(frozen=True)
class HybridPredictor:
    """A network's proposals, made equilibria of a game whose traits the window corrects."""

    weights: str = ""
    """A .safetensors file of `foresight train hybrid-game`; empty: the shipped one of recordings,
    or that of episodes where the place's game is known (`History.context.game`), as in the
    environments."""
    game: GameBetween = "infer-gamma"
    """Game between the proposals: "infer-gamma", "assume-gamma-1" or "none"."""

    def __post_init__(self) -> None:
        if self.game not in USES:
            raise ValueError(f"game: is {self.game!r}; expected one of {', '.join(USES)}")

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return USES[self.game][0]

    def predict(self, history: History, steps: int) -> Forecast:
        """Return joint futures with covariances; beyond 4.8 s they go straight on.

        Agents beyond the first eight go straight on, with the largest deviation of those.
        """
        scene, middle, found = self._solved(history)
        count = min(len(history.kinds), AGENTS)
        basis = strategy_basis(history.dt * np.arange(1, steps + 1))
        path = jax.vmap(lambda z: positions(scene.frames, z, basis))(found.strategy)
        paths = np.asarray(path, dtype=float)[:, :count].swapaxes(1, 2) + middle
        spread = np.asarray(deviations(found.spread, basis), dtype=float)[:, :count]
        rotation = np.asarray(scene.frames.rotation, dtype=float)[:count]
        calibration = float(self._network(history)[1]["calibration"])
        covariance = np.einsum(
            "aij,matj,alj->mtail", rotation, (calibration * spread) ** 2, rotation
        )
        probabilities = np.exp(np.asarray(found.logits, dtype=float))
        gamma, deviation = _gammas(found, count)
        rest = len(history.kinds) - count
        if rest:
            line = ConstantVelocityPredictor().predict(history, steps).most_likely[:, count:]
            paths = np.concatenate([paths, np.broadcast_to(line, (len(paths), *line.shape))], 2)
            most = covariance.max(axis=(2, 3, 4))[..., None, None, None] * np.eye(2)
            covariance = np.concatenate([covariance, np.repeat(most, rest, axis=2)], axis=2)
            gamma, deviation = (
                np.concatenate([values, np.full(rest, np.nan)]) for values in (gamma, deviation)
            )
        prior = 0.25 * (1.0 - LEAST_GAMMA)
        return Forecast(
            paths,
            probabilities / probabilities.sum(),
            covariance,
            gamma,
            deviation,
            np.nan_to_num(deviation, nan=np.inf) < IDENTIFIED * prior,
            not bool(found.solved[0]),
        )

    def explain(self, history: History) -> Explanation:
        """Return the parameters behind the most likely future."""
        scene, middle, found = self._solved(history)
        count = min(len(history.kinds), AGENTS)
        goals = positions(scene.frames, found.preferred[0], GAME_BASIS)[:count, -1]
        gamma, deviation = _gammas(found, count)
        near = np.clip(gamma[:, None] + 1.645 * np.outer(deviation, [-1.0, 1.0]), LEAST_GAMMA, 1.0)
        met = interactions(
            scene.frames, scene.bodies, jax.tree.map(lambda v: v[0], found.traits),
            found.strategy[0], GAME_BASIS,
        )  # fmt: skip
        return Explanation(
            np.asarray(goals, dtype=float) + middle,
            gamma,
            near,
            np.asarray(met)[:count, :count],
            bool(found.solved[0]),
            float(np.mean(np.asarray(found.solved))),
        )

    def _network(self, history: History) -> tuple[ProposalNetwork, dict[str, Any]]:
        if self.weights:
            return _loaded(Path(self.weights))
        folder = FOLDER if history.context.game is None else FOLDER / SIMULATED
        return _loaded(folder / f"{NAME}.safetensors")

    def _solved(self, history: History) -> tuple[Scene, Float[np.ndarray, "2"], JointFutures]:
        places = next(p for p in PLACES if p >= min(len(history.kinds), AGENTS))
        scene, middle = scene_of(history, places)
        return scene, middle, _futures(self._network(history)[0], scene, USES[self.game][1])


def _gammas(found: JointFutures, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations of discount factors over the sets of traits."""
    weight = np.asarray(found.hypotheses, dtype=float)[:, None]
    gamma = np.asarray(found.traits.gamma, dtype=float)[:, :count]
    part = (gamma - LEAST_GAMMA) / (1.0 - LEAST_GAMMA)
    slope = (1.0 - LEAST_GAMMA) * part * (1.0 - part)
    within = (slope * np.asarray(found.trait_deviation, dtype=float)[:, :count, 0]) ** 2
    mean = (weight * gamma).sum(axis=0)
    variance = (weight * (within + (gamma - mean) ** 2)).sum(axis=0)
    return mean, np.sqrt(variance)
