"""Training of `hybrid-game`: the network alone, then with the game between its proposals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.cluster.vq import kmeans2

from agents.hybrid.augmentation import augmented
from agents.hybrid.futures import GameUse
from agents.hybrid.loss import Example, futures_loss
from agents.hybrid.network import COEFFICIENTS, MODES, UNIT, ProposalNetwork
from agents.hybrid.strategies import GAME_BASIS
from agents.learned.training import Epoch, Schedule, Trained, train

PROPOSING = Schedule(
    epochs=12, batch=32, rate=2e-3, decay=1e-2, patience=5, warmup=100, most_norm=1.0
)
"""Of the network alone."""
PLAYING = Schedule(epochs=3, batch=32, rate=3e-4, decay=1e-2, patience=3, warmup=50, most_norm=1.0)
"""With the game."""
SAMPLE = 4000
"""Futures that anchors are chosen from."""


class TrainingData(NamedTuple):
    """Examples for both stages; those of the second have fewer places for agents."""

    proposing: Example
    playing: Example
    proposing_validation: Example
    playing_validation: Example


@dataclass(frozen=True)
class HybridTraining:
    """How a `hybrid-game` is trained."""

    use: GameUse = GameUse()
    proposing: Schedule = PROPOSING
    playing: Schedule = PLAYING


def learn_hybrid(
    data: TrainingData,
    folder: Path,
    training: HybridTraining = HybridTraining(),
    on_epoch: Callable[[str, Epoch], None] = lambda stage, epoch: None,
) -> Trained:
    """Train in two stages, with checkpoints below `folder`; resume from the last one."""
    anchors = anchors_of(data.proposing, training.proposing.seed)
    alone = train(
        partial(_network, anchors),
        partial(futures_loss, use=GameUse(game=False)),
        data.proposing,
        data.proposing_validation,
        folder / "proposing",
        training.proposing,
        augment=augmented,
        on_epoch=partial(on_epoch, "proposing"),
    )
    if not training.use.game:
        return alone
    return train(
        lambda key: alone.network,
        partial(futures_loss, use=training.use),
        data.playing,
        data.playing_validation,
        folder / "playing",
        training.playing,
        augment=augmented,
        on_epoch=partial(on_epoch, "playing"),
    )


def _network(anchors: Float[np.ndarray, "M coefficients"], key: Any) -> ProposalNetwork:
    return ProposalNetwork(key=key, anchors=anchors)


def anchors_of(examples: Example, seed: int) -> Float[np.ndarray, "M coefficients"]:
    """Return the centres of clusters of recorded futures, as coefficients in their units."""
    frames = examples.scene.frames
    line = frames.place[:, :, None] + GAME_BASIS.times[:, None] * frames.velocity[:, :, None]
    away = np.einsum("saik,sati->satk", frames.rotation, examples.target - line)
    unit = UNIT[0] + UNIT[1] * examples.scene.seen.kind[..., 1]
    whole = examples.known.all(axis=-1)
    fitted = np.einsum("bt,satk->sabk", np.linalg.pinv(GAME_BASIS.value), away)
    numbers = (fitted / unit[..., None, None]).reshape(*whole.shape, COEFFICIENTS)[whole]
    chosen = np.random.default_rng(seed).permutation(len(numbers))[:SAMPLE]
    centres, _ = kmeans2(
        numbers[chosen].astype(float), MODES, minit="++", rng=np.random.default_rng(seed)
    )
    return np.asarray(centres.astype(np.float32))
