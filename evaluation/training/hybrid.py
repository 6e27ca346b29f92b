"""Training of `hybrid-game`: the network's proposals, then the traits of the game between them.

The second stage leaves the proposals as they are (docs/development/design.md, "Predictors").
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2

from agents.hybrid.augmentation import augmented
from agents.hybrid.futures import GameUse, joint_futures
from agents.hybrid.loss import Example, futures_loss, negative_log_likelihood
from agents.hybrid.network import COEFFICIENTS, MODES, UNIT, ProposalNetwork
from agents.hybrid.smooth_game import positions
from agents.hybrid.strategies import GAME_BASIS
from agents.learned.training import Epoch, Schedule, Trained, every_array, train
from agents.learned.weights import halved, single
from agents.registry import HYBRID
from evaluation.training.supervised import GRID
from evaluation.training.trained import write_trained

PROPOSING = Schedule(
    epochs=10, batch=32, rate=2e-3, decay=0.05, patience=5, warmup=100, most_norm=1.0
)
"""Of the network alone."""
PLAYING = Schedule(epochs=2, batch=32, rate=1e-3, decay=1e-2, patience=3, warmup=50, most_norm=1.0)
"""Of the traits."""
SHARES = np.linspace(0.5, 1.0, 11)
"""Of the central future's departure from kinematic motion (`ProposalNetwork.share`)."""
SAMPLE = 4000
"""Futures that anchors are chosen from."""


class Fold(NamedTuple):
    """Recordings that are held out, and examples of all others."""

    others: Example
    held: Example
    """Of S windows in which agents interact."""
    recording: Int[np.ndarray, "S"]
    """Numbers of the held windows' recordings, from 0."""


class TrainingData(NamedTuple):
    """Examples for both stages; those of the second have fewer places for agents."""

    proposing: Example
    playing: Example
    proposing_validation: Example
    playing_validation: Example
    folds: tuple[Fold, ...] = ()
    """To calibrate by; without them the last validation data are for that."""


def learn_hybrid(
    data: TrainingData,
    folder: Path,
    *,
    use: GameUse = GameUse(),
    share: float | None = None,
    proposing: Schedule = PROPOSING,
    playing: Schedule = PLAYING,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
) -> Trained:
    """Train in two stages, with checkpoints below `folder`; resume from the last one.

    The first trains proposals alone, the second the traits of the game that `use` makes of them;
    without a game there is no second stage. `share`: of the central future's departure
    (`ProposalNetwork.share`); None takes the one with the least error on the validation data.
    """
    alone = _proposing(data.proposing, data, folder / "proposing", proposing, on_epoch)
    if share is None:
        errors, _ = _errors(alone.network, data.proposing_validation)
        share = float(SHARES[int(np.argmin(errors.sum(axis=0)))])
    alone = alone._replace(network=with_share(alone.network, share))
    if not use.game:
        return alone
    return train(
        lambda key: alone.network,
        partial(futures_loss, use=use),
        data.playing,
        data.playing_validation,
        folder / "playing",
        playing,
        augment=augmented,
        trainable=traits_alone,
        on_epoch=on_epoch,
    )


def train_hybrid(
    data: TrainingData,
    folder: Path,
    proposing: Schedule = PROPOSING,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
) -> Trained:
    """Train and calibrate, and write `hybrid-game.safetensors`, its description and the curve.

    Weights are written in half precision, and calibrated as they are written, or by folds
    (`cross_calibration`).
    """
    begin = time.perf_counter()
    share, factor = None, None
    if data.folds:
        share, factor = cross_calibration(data, folder, proposing, on_epoch)
    found = learn_hybrid(
        data, folder, share=share, proposing=proposing,
        playing=replace(PLAYING, seed=proposing.seed), on_epoch=on_epoch,
    )  # fmt: skip
    found = found._replace(network=halved(found.network))
    if factor is None:
        factor = calibration(single(found.network), data.playing_validation)
    about = {
        "network": HYBRID,
        "calibration": factor,
        "examples": len(data.proposing.known),
        "validation": len(data.proposing_validation.known),
    }
    write_trained(folder, HYBRID, found, about, time.perf_counter() - begin)
    return found


def _proposing(
    examples: Example,
    data: TrainingData,
    folder: Path,
    schedule: Schedule,
    on_epoch: Callable[[Epoch], None],
) -> Trained:
    """Train the network alone."""
    return train(
        partial(_network, anchors_of(examples, schedule.seed)),
        partial(futures_loss, use=GameUse(game=False)),
        examples,
        data.proposing_validation,
        folder,
        schedule,
        augment=augmented,
        trainable=all_but_anchors,
        on_epoch=on_epoch,
    )


def cross_calibration(
    data: TrainingData, folder: Path, schedule: Schedule, on_epoch: Callable[[Epoch], None]
) -> tuple[float, float]:
    """Return the share and the factor of deviations that are best for held-out recordings.

    The share (`ProposalNetwork.share`) with which central futures err least, and with it the factor
    that makes futures most likely, in windows in which agents interact, as in the tables: there
    futures are harder to predict. The networks were trained without the recordings; every
    recording counts the same. Their epochs are chosen on the usual validation data, which have the
    ends of long recordings.

    Args:
        data: with folds.
        folder: for checkpoints.
        schedule: of each fold's training.
        on_epoch: called after each of their epochs.

    Returns:
        The share, one of `SHARES`; the factor of deviations, one of `GRID`.
    """
    networks = [
        _proposing(fold.others, data, folder / f"calibrating_{k}", schedule, on_epoch).network
        for k, fold in enumerate(data.folds)
    ]
    pairs = list(zip(networks, data.folds, strict=True))
    errors = sum(_by_recording(*_errors(n, fold.held), fold.recording) for n, fold in pairs)
    share = float(SHARES[int(np.argmin(errors))])
    losses = sum(
        _by_recording(
            *_losses(with_share(n, share), fold.held, GameUse(game=False)), fold.recording
        )
        for n, fold in pairs
    )
    return share, float(GRID[int(np.argmin(losses))])


def _by_recording(
    sums: Float[np.ndarray, "S F"], counts: Int[np.ndarray, "S"], recording: Int[np.ndarray, "S"]
) -> Float[np.ndarray, "F"]:
    """Sum over recordings of the mean over all their agents."""
    found = np.zeros(sums.shape[1])
    for number in range(int(recording.max()) + 1):
        mine = recording == number
        found += sums[mine].sum(axis=0) / max(1, int(counts[mine].sum()))
    return found


def with_share(network: ProposalNetwork, share: Any) -> ProposalNetwork:
    """Return the network with this share of the central future's departure."""
    found: ProposalNetwork = eqx.tree_at(
        lambda n: n.share, network, jnp.asarray(share, jnp.float32)
    )
    return found


@eqx.filter_jit
def _errors_of_scenes(network: ProposalNetwork, examples: Example) -> Any:
    def one(example: Example) -> Any:
        known = jnp.asarray(example.known)
        steps = jnp.maximum(known.sum(axis=1), 1)

        def error(share: Any) -> Any:
            found = joint_futures(with_share(network, share), example.scene, GameUse(game=False))
            path = positions(example.scene.frames, found.strategy[0], GAME_BASIS)
            away = jnp.linalg.norm(path - example.target, axis=-1)
            return jnp.sum(jnp.sum(jnp.where(known, away, 0.0), axis=1) / steps)

        return jax.vmap(error)(jnp.asarray(SHARES, jnp.float32)), jnp.sum(known.any(axis=1))

    return jax.lax.map(one, examples)


def _errors(
    network: ProposalNetwork, examples: Example
) -> tuple[Float[np.ndarray, "S F"], Int[np.ndarray, "S"]]:
    """Return displacements (m) of central futures by share, and numbers of agents.

    Displacements are summed over a scene's agents.
    """
    errors, counts = _errors_of_scenes(network, examples)
    return np.asarray(errors, float), np.asarray(counts)


def calibration(network: ProposalNetwork, examples: Example) -> float:
    """Return the factor of deviations that makes the examples most likely."""
    return float(GRID[int(np.argmin(_losses(network, examples, GameUse())[0].sum(axis=0)))])


@eqx.filter_jit
def _losses_of_scenes(network: ProposalNetwork, examples: Example, use: GameUse) -> Any:
    def one(example: Example) -> Any:
        found = joint_futures(network, example.scene, use)
        known = jnp.asarray(example.known).any(axis=1)
        each = [negative_log_likelihood(found, example, float(f)) for f in GRID]
        return jnp.stack([jnp.sum(jnp.where(known, v, 0.0)) for v in each]), jnp.sum(known)

    return jax.lax.map(one, examples)


def _losses(
    network: ProposalNetwork, examples: Example, use: GameUse
) -> tuple[Float[np.ndarray, "S F"], Int[np.ndarray, "S"]]:
    """Negative log-likelihoods by factor, summed over a scene's agents, and how many those are."""
    losses, counts = _losses_of_scenes(network, examples, use)
    return np.asarray(losses), np.asarray(counts)


def all_but_anchors(network: ProposalNetwork) -> Any:
    """Return which arrays stage one changes; the decay of weights would shrink anchors."""
    return eqx.tree_at(lambda n: (n.anchors, n.share), every_array(network), (False, False))


def traits_alone(network: ProposalNetwork) -> Any:
    """Return which arrays make the traits of games, and the noise of windows."""
    nothing = jax.tree.map(lambda _: False, network)
    made = (every_array(network.trait), True)
    return eqx.tree_at(lambda n: (n.trait, n.noise), nothing, made)


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
