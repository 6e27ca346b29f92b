"""Overlay of an agent on the scene: its predictions, its plan and its estimates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from foresight_env.annotations import no_type_check


class Alternative(NamedTuple):
    """One of several possibilities that the first controlled agent plans for."""

    name: str
    weight: float
    """In [0, 1]; those of an overlay add up to 1."""
    predicted: Mapping[int, Float[np.ndarray, "K 2"]]
    """Predicted positions of other players, m."""


@no_type_check
@dataclass(frozen=True)
class Overlay:
    """Trajectories (m) and discount factors to draw; players are given by index.

    The environment copies and checks it in `set_overlay` and forgets it at `reset`.
    """

    predicted: Mapping[int, Float[np.ndarray, "K 2"]] = field(default_factory=dict)
    """Predicted positions of other players, dashed."""
    planned: Float[np.ndarray, "K 2"] | None = None
    """Positions that the first controlled agent plans to pass, solid."""
    gammas: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """Inferred discount factors: mean and standard deviation."""
    truth_gammas: Mapping[int, float] = field(default_factory=dict)
    """True discount factors, a tick on each bar."""
    alternatives: tuple[Alternative, ...] = ()
    """Possibilities that the plan is for, the most likely among them: their weights are listed, and
    the others' paths drawn thin."""
    intervention: bool = False
    """Whether a safety filter replaced the first controlled agent's action: drawn as a ring."""

    def checked(self, players: int) -> Overlay:
        """A copy that shares no arrays; `ValueError` names what is wrong."""
        for name in ("predicted", "gammas", "truth_gammas"):
            entries = getattr(self, name)
            if not isinstance(entries, Mapping):
                raise ValueError(f"overlay.{name}: expected a mapping from player to value")
            for player in entries:
                if player not in range(players):
                    raise ValueError(
                        f"overlay.{name}: {player!r} is no player; players are 0..{players - 1}"
                    )
        return Overlay(
            {i: _path(f"predicted[{i}]", path) for i, path in self.predicted.items()},
            None if self.planned is None else _path("planned", self.planned),
            {i: _interval(i, value) for i, value in self.gammas.items()},
            {i: _number(f"truth_gammas[{i}]", g) for i, g in self.truth_gammas.items()},
            tuple(_alternative(k, a, players) for k, a in enumerate(self.alternatives)),
            bool(self.intervention),
        )


def _alternative(number: int, value: Any, players: int) -> Alternative:
    where = f"alternatives[{number}]"
    if not isinstance(value, Alternative):
        raise ValueError(f"overlay.{where}: is {value!r}; expected an Alternative")
    for player in value.predicted:
        if player not in range(players):
            raise ValueError(
                f"overlay.{where}.predicted: {player!r} is no player; players are 0..{players - 1}"
            )
    weight = _number(f"{where}.weight", value.weight)
    if not 0.0 <= weight <= 1.0:
        raise ValueError(f"overlay.{where}.weight: is {weight:g}; expected 0 to 1")
    paths = {i: _path(f"{where}.predicted[{i}]", path) for i, path in value.predicted.items()}
    return Alternative(str(value.name), weight, paths)


def _numeric(name: str, value: Any, shape: str) -> np.ndarray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"overlay.{name}: expected {shape}, got {value!r}") from error
    if not np.isfinite(array).all():
        raise ValueError(f"overlay.{name}: contains NaN or infinity; leave such entries out")
    return array


def _path(name: str, value: Any) -> Float[np.ndarray, "K 2"]:
    path = _numeric(name, value, "positions (K, 2)")
    if path.ndim != 2 or path.shape[1] != 2:
        raise ValueError(f"overlay.{name}: has shape {path.shape}; expected (K, 2)")
    return path


def _interval(player: int, value: Any) -> tuple[float, float]:
    pair = _numeric(f"gammas[{player}]", value, "(mean, deviation)")
    if pair.shape != (2,) or pair[1] < 0.0:
        raise ValueError(
            f"overlay.gammas[{player}]: is {value!r}; expected (mean, deviation), deviation >= 0"
        )
    return float(pair[0]), float(pair[1])


def _number(name: str, value: Any) -> float:
    number = _numeric(name, value, "a number")
    if number.ndim:
        raise ValueError(f"overlay.{name}: has shape {number.shape}; expected a number")
    return float(number)
