"""A network in the ETH/UCY protocol, trained on exported tensors (extra `learned`).

foresight export DATA --out tensors
python own_jax_predictor.py tensors weights    # for each scene, on all others
foresight evaluate eth-ucy --data DATA --weights weights --predictors own_jax_predictor:OwnMlp
"""

import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from agents import Forecast, History

AHEAD = np.arange(1, 13)  # steps of 0.4 s


@eqx.filter_jit
def futures(network, moved):
    """Next 12 displacements from now (N, 12), from the last 7 (N, 7); in the complex plane."""
    last = moved[:, -1:] + 1e-9
    own = moved / last * jnp.abs(last)  # each agent looks along the real axis
    found = jax.vmap(network)(jnp.concatenate([own.real, own.imag], axis=1))
    return AHEAD * last + (found[:, :12] + 1j * found[:, 12:]) * last / jnp.abs(last)


class OwnMlp:
    """One future of up to 12 steps; `weights` is the folder of the scene that it is tested on."""

    name = "own-mlp"

    def __init__(self, weights=None):
        self.network = eqx.nn.MLP(14, 24, 64, 2, key=jax.random.key(0))
        if weights is not None:  # arrays alone: no pickle
            self.network = eqx.tree_deserialise_leaves(f"{weights}/own-mlp.eqx", self.network)

    def predict(self, history: History, steps: int) -> Forecast:
        places = history.states[-8:, :, :2] @ np.array([1.0, 1.0j])  # (8, N)
        moved = np.diff(places, axis=0)
        moved = np.nan_to_num(np.where(np.isnan(moved), moved[-1], moved)).T
        paths = (places[-1][:, None] + np.asarray(futures(self.network, moved))).T[:steps]
        return Forecast(np.stack([paths.real, paths.imag], axis=-1)[None], np.ones(1))


def train(past, future, rounds):
    """Train a network on positions (B, 8) and (B, 12)."""
    network, optimiser = OwnMlp().network, optax.adam(1e-3)
    state = optimiser.init(eqx.filter(network, eqx.is_array))

    def loss(network, past, future):
        away = futures(network, jnp.diff(past)) - (future - past[:, -1:])
        return jnp.sqrt(away.real**2 + away.imag**2 + 1e-9).mean()

    @eqx.filter_jit
    def step(network, state, *batch):
        updates, state = optimiser.update(eqx.filter_grad(loss)(network, *batch), state)
        return eqx.apply_updates(network, updates), state

    for seed in range(rounds):
        rows = np.random.default_rng(seed).integers(0, len(past), 256)
        network, state = step(network, state, past[rows], future[rows])
    return network


def main(tensors="tensors", weights="weights", rounds=2000):
    """Train a network for each scene on the agents that count in all others."""
    found = np.load(Path(tensors) / "tensors.npz", allow_pickle=False)
    past, future = (found[name] @ np.array([1.0, 1.0j]) for name in ("history", "future"))
    for scene in np.unique(found["scene"]):
        rows = found["counted"] & (found["scene"] != scene)[:, None]
        (Path(weights) / scene).mkdir(parents=True, exist_ok=True)
        network = train(past[rows], future[rows], rounds)
        eqx.tree_serialise_leaves(Path(weights) / scene / "own-mlp.eqx", network)


if __name__ == "__main__":
    main(*sys.argv[1:])
