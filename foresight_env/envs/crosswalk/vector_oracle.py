"""Behaviours of module `core.behaviours` for many crosswalks, all games in one batch."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from foresight_env.envs.core.behaviours import NOTHING_SOLVED
from foresight_env.envs.crosswalk.functional import CrosswalkSetting, CrosswalkState
from foresight_env.equilibrium import Solution, Status
from foresight_env.equilibrium.batch.solve_many import solve_checked
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import layout_of


class VectorOracle:
    """Plans of B environments, and how their solves went; `behaviours.Receding` or `OpenLoop`."""

    def __init__(self, setting: CrosswalkSetting, count: int) -> None:
        self._layout = layout_of(setting.game)
        self._receding = setting.behaviour == "receding"
        self._players = setting.players
        layout, horizon = self._layout, setting.game.horizon
        sizes = (layout.n, layout.m, layout.pair_count, layout.pair_count)
        blank: list[Any] = [np.zeros((count, horizon, size)) for size in sizes]
        self._plans = Iterate(*blank)
        self.known: Bool[np.ndarray, "B"] = np.zeros(count, dtype=bool)
        """Environments with a plan; agents of the others brake."""
        self.status: Int[np.ndarray, "B"] = np.full(count, NOTHING_SOLVED)
        self.residual: Float[np.ndarray, "B"] = np.zeros(count)
        self.failures: Int[np.ndarray, "B"] = np.zeros(count, dtype=int)

    def forget(self, places: Int[np.ndarray, "b"]) -> None:
        """New episodes begin there."""
        self.known[places] = False
        self.status[places] = NOTHING_SOLVED
        self.residual[places] = 0.0
        self.failures[places] = 0

    def act(self, state: CrosswalkState, live: Bool[np.ndarray, "B"]) -> Float[np.ndarray, "B N 2"]:
        """Controls of all players (m/s^2) where `live`; only read where `known`."""
        if self._receding:
            return self._receding_controls(state, live)
        fresh = np.flatnonzero(live & (self.status == NOTHING_SOLVED))
        self._solve_cold(state, fresh)
        horizon = self._plans.u.shape[1]
        stage = np.minimum(state.steps, horizon - 1)
        found = self._plans.u[np.arange(len(stage)), stage]
        return np.array(found).reshape(-1, self._players, 2)

    def _receding_controls(
        self, state: CrosswalkState, live: Bool[np.ndarray, "B"]
    ) -> Float[np.ndarray, "B N 2"]:
        again, cold = live & self.known, live & ~self.known
        if again.any():
            self._plans = jax.tree.map(_shifted, self._plans)
            # All of them, those that are not asked for last: the batch keeps its size.
            chosen = np.argsort(~again, kind="stable")
            asked = int(again.sum())
            warm = jax.tree.map(lambda v: v[chosen], self._plans)
            found = solve_checked(self._layout, self._parameters(state, chosen), warm, active=asked)
            self._take(found, chosen[:asked])
        self._solve_cold(state, np.flatnonzero(cold))
        return np.array(self._plans.u[:, 0]).reshape(-1, self._players, 2)

    def _solve_cold(self, state: CrosswalkState, places: Int[np.ndarray, "b"]) -> None:
        """Solve there without an initial guess."""
        if not places.size:
            return
        asked = places.size
        chosen = np.concatenate([places, np.repeat(places[-1:], padded(asked) - asked)])
        found = solve_checked(self._layout, self._parameters(state, chosen), None, active=asked)
        self._take(found, places)

    def _take(self, found: Solution, places: Int[np.ndarray, "b"]) -> None:
        """The first games of `found` become the plans of environments `places`, in this order.

        Who fails keeps the plan it has, if it has one.
        """
        status = found.status[: places.size]
        residual = found.residual[: places.size]
        rows = np.flatnonzero(status == Status.SOLVED)
        solved = places[rows]
        for plan, point in zip(self._plans, found.point, strict=True):
            plan[solved] = np.asarray(point)[rows]
        self.known[solved] = True
        self.status[places] = status
        self.residual[places] = np.where(np.isfinite(residual), residual, np.inf)
        self.failures[places] += status != Status.SOLVED

    def _parameters(self, state: CrosswalkState, chosen: Int[np.ndarray, "b"]) -> Parameters:
        episode_parameters = jax.tree.map(lambda v: v[chosen], state.episode_parameters)
        joint = state.states[chosen].reshape(len(chosen), -1)
        return Parameters(joint, episode_parameters.theta, episode_parameters.gamma)


def padded(count: int) -> int:
    """The size of a batch that is compiled for so many: a power of four, so that few are."""
    size = 1
    while size < count:
        size *= 4
    return size


def _shifted(plan: np.ndarray) -> np.ndarray:
    """One stage later, the last repeated."""
    return np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
