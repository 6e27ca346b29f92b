"""Prior of the parameters, as quadratic terms of the objective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from foresight_env.equilibrium.conditions.kkt import Parameters
from foresight_env.games.types import Theta
from foresight_env.inverse.coordinates import Coordinates


@dataclass(frozen=True, eq=False)
class Prior:
    """`gamma_weight * ||gamma - gamma_center||^2` (paper, section VI-E), a Gaussian on the rest.

    `gamma_center` is the centre of the discount factors' prior: 1 far-sighted, 0 myopic. `mean` and
    `information` (p,), (p, p), over all free parameters in the order of `Estimate.parameters`, add
    a Gaussian belief: an earlier estimate's `values` and the inverse of its `covariance`.
    """

    gamma_weight: float | tuple[float, ...] = 1e-3
    """A number, or one per player: people and cars may be believed in differently."""
    gamma_center: float | tuple[float, ...] = 1.0
    """A number, or one per player."""
    theta_deviation: tuple[tuple[str, float], ...] = ()
    """Names of entries of `theta` with the standard deviation of a belief around their centre, such
    as `(("goal", 3.0),)`."""
    theta_center: tuple[Theta, ...] | None = None
    """Centres of those beliefs, one mapping per player; None: where the caller's search starts."""
    mean: Float[np.ndarray, "p"] | None = None
    information: Float[np.ndarray, "p p"] | None = None


def prior_terms(
    prior: Prior,
    coordinates: Coordinates,
    start: Parameters,
    free: Bool[np.ndarray, "p"],
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """One mean and a square root of the information that stand for all terms of the prior.

    `start`: where the caller's search starts. Fixed parameters have no prior.
    """
    centers = start if prior.theta_center is None else start._replace(theta=prior.theta_center)
    values = np.asarray(coordinates.pack(centers))
    spread = dict(prior.theta_deviation)
    estimated = {name for names in coordinates.sizes for name, _ in names}
    for name, deviation in spread.items():
        if name not in estimated:
            raise ValueError(
                f"prior.theta_deviation: names {name!r}; estimated are {sorted(estimated)}"
            )
        if not deviation > 0.0:
            raise ValueError(
                f"prior.theta_deviation: {name!r} is {deviation}; expected more than 0"
            )
    entries = [parameter.entry for parameter in coordinates.parameters]
    believed = np.array([spread[e] ** -2.0 if e in spread else 0.0 for e in entries])
    weight = np.where(coordinates.is_gamma, 0.0, believed)
    center = values.copy()
    count = len(coordinates.layout.game.players)
    weight[coordinates.is_gamma] = _per_player("gamma_weight", prior.gamma_weight, count)
    center[coordinates.is_gamma] = _per_player("gamma_center", prior.gamma_center, count)
    weight = weight * free
    if (prior.mean is None) != (prior.information is None):
        raise ValueError("prior: mean and information belong together; give both or neither")
    if prior.mean is None or prior.information is None:
        return center, np.diag(np.sqrt(weight))
    count = int(free.sum())
    mean, belief = np.asarray(prior.mean), np.asarray(prior.information)
    if mean.shape != (count,) or belief.shape != (count, count):
        raise ValueError(
            f"prior: mean {mean.shape} and information {belief.shape}; expected ({count},) and "
            f"({count}, {count})"
        )
    total = np.diag(weight[free]) + belief
    combined = center.copy()
    combined[free] = np.linalg.lstsq(
        total, weight[free] * center[free] + belief @ mean, rcond=None
    )[0]
    spectrum, basis = np.linalg.eigh(0.5 * (total + total.T))
    if spectrum[0] < -1e-9 * max(spectrum[-1], 1.0):
        raise ValueError("prior.information: is not positive semidefinite")
    root = np.zeros((values.size, values.size))
    root[np.ix_(free, free)] = np.sqrt(np.maximum(spectrum, 0.0))[:, None] * basis.T
    return combined, root


def _per_player(name: str, value: float | tuple[float, ...], count: int) -> Float[np.ndarray, "N"]:
    """One number per player; both settings are at least 0."""
    each = np.asarray(value, dtype=float)
    if each.shape not in ((), (count,)) or not (np.isfinite(each) & (each >= 0.0)).all():
        raise ValueError(
            f"prior.{name}: is {value}; expected a number of at least 0, or {count} of them, one "
            "per player"
        )
    return np.broadcast_to(each, (count,))
