"""The learned estimator of discount factors, with shipped or custom weights."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from agents.learned.gamma_network import WINDOW, GammaNetwork, gamma_window
from agents.learned.weights import FOLDER, load_network


@lru_cache(maxsize=8)
def _loaded(path: Path) -> Any:
    network, _ = load_network(path, lambda description: GammaNetwork(key=jax.random.key(0)))
    return network


@eqx.filter_jit
def _said(network: Any, own: Any, other: Any) -> Any:
    return network(own, other)


def learned_gamma(
    observed: Float[np.ndarray, "window 2 4"], weights: str = ""
) -> tuple[float, float]:
    """Mean and standard deviation of the other's discount factor at a crosswalk of two.

    `observed`: the last `WINDOW` observed states `[px, py, vx, vy]` of the ego and of the other, m
    and m/s, every 0.1 s; `weights`: a file of `foresight train gamma`, the shipped one where empty.
    """
    if observed.shape != (WINDOW, 2, 4):
        raise ValueError(f"observed: has shape {observed.shape}; expected {(WINDOW, 2, 4)}")
    if not np.isfinite(observed).all():
        raise ValueError("observed: holds NaN or infinity; the network wants whole windows")
    network = _loaded(Path(weights) if weights else FOLDER / "gamma.safetensors")
    mean, deviation = _said(network, *gamma_window(observed))
    return float(mean), float(deviation)
