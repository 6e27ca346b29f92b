"""Training loop of all networks: training resumes after interruption.

An epoch depends on the seed, the epoch's number and the data alone, so an interrupted training ends
with the same weights as an uninterrupted one.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from safetensors import SafetensorError, safe_open

from agents.learned.weights import packed, unpacked
from foresight_env.files import write_atomically

Loss = Callable[[Any, Any], tuple[Any, Any]]
"""From a network and one example (a PyTree of arrays): a loss, and how much it counts."""
Augment = Callable[[Any, Any], Any]
"""From one example and a random key: another example that is as true."""
Trainable = Callable[[Any], Any]
"""From a network a PyTree of booleans like it: the arrays that training changes."""


def every_array(network: Any) -> Any:
    """Return that all arrays of a network are trained."""
    return jax.tree.map(eqx.is_array, network)


@dataclass(frozen=True)
class Schedule:
    """Epochs, batches and learning rates."""

    epochs: int = 100
    batch: int = 64
    rate: float = 2e-3
    decay: float = 0.1
    """Of weights, per step (AdamW)."""
    patience: int = 15
    """Epochs without a better validation after which it ends."""
    seed: int = 0
    warmup: int = 0
    """Steps in which the rate grows from 0."""
    most_norm: float = math.inf
    """Largest norm of a step's gradient; longer ones are shortened."""


class Epoch(NamedTuple):
    """A line of the learning curve; mean losses."""

    number: int
    train: float
    validation: float


class Trained(NamedTuple):
    """Result of a training."""

    network: Any
    """Of the epoch with the best validation."""
    curve: tuple[Epoch, ...]
    best: int
    """That epoch's number."""


def train(
    make: Callable[[Any], Any],
    loss: Loss,
    examples: Any,
    validation: Any,
    folder: Path,
    schedule: Schedule = Schedule(),
    *,
    augment: Augment | None = None,
    trainable: Trainable = every_array,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
) -> Trained:
    """Train what `make(key)` makes, with checkpoints in `folder`; resume from the last one.

    `examples`, `validation`: PyTrees of NumPy arrays with a leading axis. `augment`: changes every
    example of a batch; validation uses the examples as they are. `trainable`: the arrays that are
    changed. `on_epoch`: is called with every epoch as it ends. `ValueError` where the folder
    holds the training of something else.
    """
    count = len(jax.tree.leaves(examples)[0])
    if count < 1 or len(jax.tree.leaves(validation)[0]) < 1:
        raise ValueError("examples: are none, or none to validate with; make or name more data")
    first, key = jax.random.split(jax.random.key(schedule.seed))
    start = make(first)
    batch = min(schedule.batch, count)
    steps = count // batch
    optimiser = _optimiser(schedule, steps)
    mask = trainable(start)
    blank = (start, optimiser.init(eqx.filter(start, mask)), start)
    about = {"schedule": asdict(schedule), "data": _digest((examples, validation))}
    checkpoint = Checkpoint(folder, about)
    (network, state, best), curve = checkpoint.load(blank)
    run_epoch = _epoch(loss, optimiser, augment, mask)
    judge = eqx.filter_jit(lambda network, data: _mean(loss, network, data))
    while len(curve) < schedule.epochs and not is_tired(curve, schedule.patience):
        number = len(curve)
        order = jax.random.permutation(jax.random.fold_in(key, number), count)
        order = order[: steps * batch].reshape(steps, batch)
        drawn = jax.random.fold_in(jax.random.fold_in(key, number), 1)
        keys = jax.random.split(drawn, order.shape)
        network, state, value = run_epoch(network, state, examples, order, keys)
        judged = float(judge(network, validation))
        if not np.isfinite([float(value), judged]).all():
            raise ValueError(
                f"loss: is not a number in epoch {number}; use a smaller rate than {schedule.rate}"
            )
        if not curve or judged < min(e.validation for e in curve):
            best = network
        curve = (*curve, Epoch(number, float(value), judged))
        checkpoint.save((network, state, best), curve)
        on_epoch(curve[-1])
    return Trained(best, curve, min(curve, key=lambda e: e.validation).number)


def is_tired(curve: tuple[Epoch, ...], patience: int) -> bool:
    """Whether the last `patience` epochs had no better validation."""
    if not curve:
        return False
    return len(curve) - 1 - min(curve, key=lambda e: e.validation).number >= patience


def _mean(loss: Loss, network: Any, data: Any) -> Any:
    losses, weights = jax.vmap(lambda example: loss(network, example))(data)
    return jnp.sum(losses) / jnp.maximum(jnp.sum(weights), 1)


def _optimiser(schedule: Schedule, steps: int) -> Any:
    """AdamW with a cosine schedule over all epochs; `steps` in each."""
    whole = schedule.epochs * steps
    if schedule.warmup:
        rate = optax.warmup_cosine_decay_schedule(0.0, schedule.rate, schedule.warmup, whole)
    else:
        rate = optax.cosine_decay_schedule(schedule.rate, whole)
    adam = optax.adamw(rate, weight_decay=schedule.decay)
    if math.isinf(schedule.most_norm):
        return adam
    return optax.chain(optax.clip_by_global_norm(schedule.most_norm), adam)


def _epoch(loss: Loss, optimiser: Any, augment: Augment | None, mask: Any) -> Any:
    @eqx.filter_jit
    def run(network: Any, state: Any, examples: Any, order: Any, keys: Any) -> Any:
        weights, rest = eqx.partition(network, mask)

        def step(carry: Any, chosen_rows: Any) -> Any:
            weights, state = carry
            rows, drawn = chosen_rows

            def of(weights: Any) -> Any:
                chosen = jax.tree.map(lambda v: jnp.asarray(v)[rows], examples)
                if augment is not None:
                    chosen = jax.vmap(augment)(chosen, drawn)
                return _mean(loss, eqx.combine(weights, rest), chosen)

            value, gradient = jax.value_and_grad(of)(weights)
            updates, state = optimiser.update(gradient, state, weights)
            return (optax.apply_updates(weights, updates), state), value

        (weights, state), values = jax.lax.scan(step, (weights, state), (order, keys))
        return eqx.combine(weights, rest), state, jnp.mean(values)

    return run


class Checkpoint:
    """A training's state on disk: one file, replaced as a whole."""

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self._file = folder / "checkpoint.safetensors"
        self._about = about
        folder.mkdir(parents=True, exist_ok=True)

    def load(self, blank: Any) -> tuple[Any, tuple[Epoch, ...]]:
        """The last state, or the first."""
        if not self._file.exists():
            return blank, ()
        try:
            with safe_open(self._file, "numpy") as file:
                head = {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
        except (SafetensorError, ValueError) as error:
            raise ValueError(f"{self._file}: is damaged ({error}); delete it") from error
        if head.get("about") != self._about:
            raise ValueError(
                f"{self._file}: is of a training with other data or another schedule; choose "
                "another folder or delete it"
            )
        tree = unpacked(blank, self._file.read_bytes(), str(self._file))
        return tree, tuple(Epoch(*line) for line in head["curve"])

    def save(self, tree: Any, curve: tuple[Epoch, ...]) -> None:
        """Keep this state in place of the one before."""
        head = {"about": json.dumps(self._about), "curve": json.dumps(curve)}
        write_atomically(self._file, packed(tree, head))


def _digest(tree: Any) -> str:
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        found.update(np.ascontiguousarray(leaf).tobytes())
    return found.hexdigest()[:16]
