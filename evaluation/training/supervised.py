"""`foresight train`: from episodes and recordings to weights that predict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from agents.learned.cloning import (
    CloningExample,
    CloningNetwork,
    cloning_examples,
    cloning_loss,
)
from agents.learned.features import Features
from agents.learned.gamma_network import GammaExample, GammaNetwork, gamma_examples, gamma_loss
from agents.learned.head import Futures, negative_log_likelihood
from agents.learned.predictor import NETWORKS
from agents.learned.training import Epoch, Schedule, Trained, train
from evaluation.execution.store import Row
from evaluation.rollout.episode import observed_states
from evaluation.training.examples import (
    Examples,
    mirrored,
    recorded_scenes,
    scenes_in,
    simulated_scenes,
    stack,
)
from evaluation.training.generation import episodes_in
from evaluation.training.names import CLONED, GAMMA, SUPERVISED
from evaluation.training.trained import write_trained
from evaluation.windows.eth_ucy import others
from evaluation.windows.interaction import split_of
from foresight_env.datasets import open_recording, recordings_below

GRID = np.exp(np.linspace(np.log(0.25), np.log(4.0), 81))
"""Factors of deviations that calibration tries."""


def scene_loss(network: Any, example: Examples) -> tuple[Any, Any]:
    """Of one scene, and how many agents' steps it counts for."""
    target: Any = example.target
    known: Any = example.known
    return negative_log_likelihood(network(example.seen), target, known)


def forecast_data(episodes: Sequence[Path], data: Path | None, part: str) -> Examples:
    """Scenes of a part, "train" or "validation": of all folders of episodes, and of recordings."""
    simulated = [
        scene
        for folder in episodes
        for row in episodes_in(folder / part, part)
        for scene in simulated_scenes(row)
    ]
    recorded = []
    for directory, name in [] if data is None else recordings_below(data):
        recording = open_recording(str(directory), recording=name)
        if split_of(recording.name) == "development":
            recorded += list(recorded_scenes(recording, part))
    if not (simulated or recorded):
        raise ValueError("--episodes, --data: hold nothing to learn from")
    return stack([*simulated, *recorded])


def protocol_data(data: Path, hold_out: str, part: str) -> Examples:
    """Scenes of a part, "train" or "validation", of the ETH/UCY protocol's other recordings."""
    recordings = others(data, hold_out)
    return stack([scene for recording in recordings for scene in scenes_in(recording, part)])


def gamma_data(episodes: Sequence[Path], part: str) -> GammaExample:
    """Windows of crosswalks of two."""
    found: list[GammaExample] = []
    for folder in episodes:
        for row in episodes_in(folder / part, part):
            if row["place"] == "crosswalk":
                seen = observed_states(_observations(row), row["ego"], row["players"])
                found += gamma_examples(seen, np.array(row["gamma"]))
    if not found:
        raise ValueError("--episodes: hold no crosswalks; make them with foresight generate")
    return GammaExample(*(np.stack(parts) for parts in zip(*found, strict=True)))


def cloning_data(episodes: Sequence[Path], part: str) -> CloningExample:
    """Steps of crosswalks of two without a collision."""
    found: list[CloningExample] = []
    for folder in episodes:
        for row in episodes_in(folder / part, part):
            if row["place"] == "crosswalk" and row["goal_reached"]:
                steps = row["steps"]
                observations = np.array(row["observations"]).reshape(steps, -1)
                controls = np.array(row["controls"]).reshape(steps, 2, 2)[:, 0]
                found += cloning_examples(observations, controls)
    if not found:
        raise ValueError("--episodes: hold no crosswalks; make them with foresight generate")
    return CloningExample(*(np.stack(parts) for parts in zip(*found, strict=True)))


def _observations(row: Row) -> Float[np.ndarray, "steps size"]:
    return np.array(row["observations"]).reshape(row["steps"], -1)


def calibration(network: Any, data: Examples) -> float:
    """By what deviations are to be multiplied to make the data most likely."""

    @jax.jit
    def loss(factor: Any) -> Any:
        def one(seen: Features, target: Any, known: Any) -> Any:
            found: Futures = network(seen)
            wide = found._replace(deviation=factor * found.deviation)
            return negative_log_likelihood(wide, target, known)

        losses, counts = jax.vmap(one)(data.seen, data.target, data.known)
        return losses.sum() / counts.sum()

    return float(GRID[int(np.argmin([float(loss(factor)) for factor in GRID]))])


def learn(
    name: str,
    episodes: Sequence[Path],
    data: Path | None,
    folder: Path,
    schedule: Schedule,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    *,
    hold_out: str | None = None,
) -> Trained:
    """Train, and write `NAME.safetensors`, `NAME.json`, `curve.csv` and `curve.png` in `folder`.

    `hold_out`: forecasters learn from all scenes of the ETH/UCY protocol in `data` but this one.
    """
    if name not in SUPERVISED:
        raise ValueError(f"name: {name!r} is unknown; choose from {', '.join(SUPERVISED)}")
    begin = time.perf_counter()
    examples: Any
    validation: Any
    make: Any
    loss: Any
    parts = ("train", "validation")
    if name == GAMMA:
        examples, validation = (gamma_data(episodes, part) for part in parts)
        make, loss = GammaNetwork, gamma_loss
    elif name == CLONED:
        examples, validation = (cloning_data(episodes, part) for part in parts)
        make, loss = CloningNetwork, cloning_loss
    elif hold_out is not None and data is not None:
        examples, validation = (protocol_data(data, hold_out, part) for part in parts)
        examples = stack([examples, mirrored(examples)])
        make, loss = NETWORKS[name], scene_loss
    else:
        examples, validation = (forecast_data(episodes, data, part) for part in parts)
        examples = stack([examples, mirrored(examples)])
        make, loss = NETWORKS[name], scene_loss
    found = train(
        lambda key: make(key=key), loss, examples, validation, folder, schedule, on_epoch=on_epoch
    )
    factor = calibration(found.network, validation) if name in NETWORKS else 1.0
    about = {
        "network": name,
        "calibration": factor,
        "examples": len(jax.tree.leaves(examples)[0]),
        "validation": len(jax.tree.leaves(validation)[0]),
    }
    write_trained(folder, name, found, about, time.perf_counter() - begin)
    return found
