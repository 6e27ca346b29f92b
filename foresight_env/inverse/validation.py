"""Checks of observations and starts, before anything is computed."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.observations import ObservationModel
from foresight_env.inverse.coordinates import Coordinates
from foresight_env.inverse.initial import NeverSeenError
from foresight_env.inverse.linear_step import Rates


def check_observations(
    layout: Layout, model: ObservationModel, observations: Any, covariance: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Observations (K, size) with zeros for missing entries, and whitening matrices.

    Missing entries are NaN. `covariance`: a number (times identity), (size, size), or per stage
    (K, size, size).
    """
    values = np.asarray(observations, dtype=float)
    horizon = layout.game.horizon
    if values.ndim != 2 or values.shape[1] != model.size:
        raise ValueError(
            f"observations: have shape {values.shape}; expected (stages, {model.size})"
        )
    if not 2 <= values.shape[0] <= horizon + 1:
        raise ValueError(
            f"observations: {values.shape[0]} stages; a game of horizon {horizon} has states x_1 "
            f"to x_{horizon + 1}, and two are the least to infer from"
        )
    if np.isinf(values).any():
        raise ValueError("observations: contain infinity; mark missing entries as NaN")
    seen = ~np.isnan(values)
    if not seen.any():
        raise ValueError("observations: every entry is missing")
    count, size = values.shape
    matrix = np.asarray(covariance, dtype=float)
    if matrix.ndim == 0:
        matrix = matrix * np.eye(size)
    if matrix.shape not in ((size, size), (count, size, size)):
        raise ValueError(
            f"covariance: has shape {matrix.shape}; expected a number, ({size}, {size}) or "
            f"({count}, {size}, {size})"
        )
    both = seen[:, :, None] & seen[:, None, :]
    # Missing entries become independent ones, which leaves the factors of the others as they are.
    blocks = np.where(both, matrix, np.eye(size))
    try:
        # The factorisation reads only one triangle, and NaN passes through it.
        if not np.all(np.abs(blocks - blocks.swapaxes(1, 2)) <= 1e-8 * np.abs(blocks)):
            raise np.linalg.LinAlgError("not symmetric")
        roots = np.linalg.cholesky(blocks)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "covariance: is not symmetric positive definite; noise-free data take a small "
            "positive number"
        ) from error
    return np.where(seen, values, 0.0), np.where(both, np.linalg.inv(roots), 0.0)


def check_information(
    model: ObservationModel,
    observations: Any,
    coordinates: Coordinates,
    free: np.ndarray,
    believed: np.ndarray,
) -> None:
    """Raise `ValueError` where the observations cannot say anything of what is estimated.

    Args:
        model: the observation model.
        observations: (K, size), NaN where missing.
        coordinates: of the parameters.
        free: (p,) which parameters are estimated.
        believed: (p,) about which parameters the prior knows something.

    Raises:
        NeverSeenError: the initial state of an agent is free, and neither the observations nor the
            prior know anything of this agent.
        ValueError: only `x_1` is observed, and it is known.
    """
    seen = ~np.isnan(np.asarray(observations, dtype=float))
    states = free & (coordinates.kinds == "initial_state")
    owners = np.array([parameter.player for parameter in coordinates.parameters])
    for player in np.unique(owners[states]):
        # An observed entry without an owner may depend on every player.
        tells = [owner in (None, player) for owner in model.owners]
        if not seen[:, tells].any() and not believed[states & (owners == player)].any():
            raise NeverSeenError(
                f"observations: player {player} was never observed, and its initial state is free; "
                "leave it out of the game, or fix its initial state"
            )
    if not states.any() and not seen[1:].any():
        raise ValueError(
            "observations: every entry after x_1 is missing, and x_1 is known; expected some of "
            "x_2 or later"
        )


def check_rates(layout: Layout, rates: Rates | None, guessed: bool, count: int) -> None:
    """Raise `ValueError` where rates do not fit the game or come without an initial guess."""
    if rates is None:
        return
    if not guessed:
        raise ValueError(
            "initial_guess_rates: holds derivatives of `initial_guess`; expected with an "
            "initial guess only"
        )
    shapes = (np.shape(rates.states), np.shape(rates.carry))
    wanted = ((layout.game.horizon + 1, layout.n, count), (count, count))
    if shapes != wanted:
        raise ValueError(
            f"initial_guess_rates: has states {shapes[0]} and carry {shapes[1]}; expected "
            f"{wanted[0]} and {wanted[1]}"
        )


def check_start(
    coordinates: Coordinates,
    values: Float[np.ndarray, "p"],
    low: Float[np.ndarray, "p"],
    high: Float[np.ndarray, "p"],
) -> None:
    """Raise `ValueError` where a parameter starts outside the range that it is looked for in.

    Initial states are let in: they are noisy where observations are.
    """
    kinds = coordinates.kinds
    for k in np.flatnonzero((kinds != "initial_state") & ((values < low) | (values > high))):
        raise ValueError(
            f"{kinds[k]}: {coordinates.parameters[k]} starts at {values[k]:g}; it is estimated in "
            f"[{low[k]:g}, {high[k]:g}] (free.{kinds[k]}_range)"
        )
