"""Checks of observations and starts, before anything is computed."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.games.observations import ObservationModel
from foresight_env.inverse.coordinates import Coordinates
from foresight_env.inverse.linear_step import Rates


def check_kinds(**arguments: tuple[Any, ...]) -> None:
    """Each argument's value, then the types that it may have: raises `ValueError` by name."""
    for name, (value, *kinds) in arguments.items():
        if not isinstance(value, tuple(kinds)):
            wanted = " or ".join(k.__name__ for k in kinds if k is not type(None))
            given = getattr(value, "__name__", repr(value))
            raise ValueError(f"{name}: is {given}, not made by calling {wanted}(...)")


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
