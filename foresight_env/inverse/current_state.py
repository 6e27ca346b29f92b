"""Present state of all players: the last fit, corrected by the newest observation."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Float

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.observations import ObservationModel
from foresight_env.inverse.kalman import kalman_update


@partial(jax.jit, static_argnums=(0, 1))
def _expected(
    layout: Layout, model: ObservationModel, state: Float[Array, "n"]
) -> tuple[Float[Array, "size"], Float[Array, "size n"]]:
    """Expected observation and its derivative."""

    def seen(x: Array) -> Array:
        return model(layout.split_states(x))

    return seen(state), jax.jacfwd(seen)(state)


def corrected(
    layout: Layout,
    model: ObservationModel,
    state: Float[np.ndarray, "n"],
    excess: Float[np.ndarray, "n n"],
    observation: Float[np.ndarray, "size"],
    variance: float,
) -> tuple[Float[np.ndarray, "_"], ...]:
    """Per-player states after a Kalman update of the joint `state`.

    `excess` is the covariance of what is not yet accounted for: where the fit has used the
    observation already, of what the model, not the noise, gets wrong; else of the whole state.
    """
    seen = ~np.isnan(observation)
    with jax.enable_x64(True):
        expected, rates = (np.asarray(v)[seen] for v in _expected(layout, model, state))
    noise = variance * np.eye(len(rates))
    state, _ = kalman_update(state, excess, rates, observation[seen] - expected, noise)
    return tuple(state[s] for s in layout.state_slices)
