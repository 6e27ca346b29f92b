"""What uncontrolled agents do: they play an equilibrium of the game, or anything else one adds.

A behaviour sees the true states of everybody, once per step, and answers with controls. The two
here are the *oracle*: they know every player's true parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from foresight_env.envs.core.motion import brake
from foresight_env.equilibrium import Solution, Status, shift, solve
from foresight_env.games import Game
from foresight_env.scenarios.episode_parameters import EpisodeParameters

NOTHING_SOLVED = -1
"""`SolverReport.status` while there has been no solve in this episode."""


class SolverReport(NamedTuple):
    """How the solves of this episode went."""

    status: int = NOTHING_SOLVED
    """`equilibrium.Status` of the latest solve, or `NOTHING_SOLVED`."""
    residual: float = 0.0
    """Scaled KKT residual of the latest solve; infinite when it is not a number."""
    failures: int = 0
    """Steps of this episode whose solve did not end with `Status.SOLVED`."""


class BehaviourSetting(NamedTuple):
    """What a behaviour is made for; the same during the whole life of an environment."""

    game: Callable[[int], Game]
    """The game of all players over so many stages."""
    planning_horizon: int
    """Stages."""
    max_steps: int

    @property
    def players(self) -> int:
        """How many agents there are, controlled or not."""
        return len(self.game(self.planning_horizon).players)


class Behaviour(Protocol):
    """How uncontrolled agents act. One object serves one environment."""

    @property
    def report(self) -> SolverReport:
        """How the solves of this episode went; the default where nothing is solved."""

    @property
    def planned(self) -> tuple[Float[np.ndarray, "K 2"], ...] | None:
        """Per player the positions (m) that it plans to pass, for drawing; None: no plan."""

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        """Begin an episode."""

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of all players at the true `states`; called once per step.

        The environment uses the rows of uncontrolled agents.
        """


BehaviourFactory = Callable[[BehaviourSetting], Behaviour]
"""Makes a behaviour; a class with a constructor of this form is one."""


class _Oracle:
    """What both oracles share: a game, an episode's parameters and a plan that may be missing."""

    def __init__(self, game: Game) -> None:
        self._game = game
        self._episode: EpisodeParameters | None = None
        self._plan: Solution | None = None
        self._report = SolverReport()

    @property
    def report(self) -> SolverReport:
        return self._report

    @property
    def planned(self) -> tuple[Float[np.ndarray, "K 2"], ...] | None:
        if self._plan is None:
            return None
        return tuple(np.array(states[:, :2]) for states in self._plan.states)

    def reset(self, episode_parameters: EpisodeParameters) -> None:
        self._episode, self._plan, self._report = episode_parameters, None, SolverReport()

    def _solve(
        self, states: Float[np.ndarray, "N n"], initial_guess: Solution | None
    ) -> Solution | None:
        """A solution; None when there was none to be found."""
        if self._episode is None:
            raise RuntimeError("act: there is no episode; call reset first")
        _, theta, gamma = self._episode
        found = solve(self._game, states, theta, gamma, initial_guess=initial_guess)
        solved = int(found.status) == Status.SOLVED
        residual = float(found.residual)
        self._report = SolverReport(
            int(found.status),
            residual if np.isfinite(residual) else float("inf"),
            self._report.failures + (not solved),
        )
        return found if solved else None

    def _first_controls(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        if self._plan is None:
            return brake(self._game, states)
        return np.stack([controls[0] for controls in self._plan.controls])


class Receding(_Oracle):
    """Re-solves the game of all players at every step and plays the first stage of the solution.

    Each solve starts from the previous solution, shifted by one stage. When it fails, the shifted
    plan is played on; without one, everybody brakes to rest.
    """

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting.game(setting.planning_horizon))

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of the first stage of the plan made at `states`."""
        shifted = None if self._plan is None else shift(self._plan)
        found = self._solve(states, shifted)
        self._plan = shifted if found is None else found
        return self._first_controls(states)


class OpenLoop(_Oracle):
    """Solves the game over the whole episode once, at its first step, and follows the plan.

    When that solve fails, everybody brakes to rest and stays there.
    """

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting.game(setting.max_steps))

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of this step's stage of the one plan."""
        if self._report.status == NOTHING_SOLVED:
            self._plan = self._solve(states, None)
        elif self._plan is not None:
            self._plan = shift(self._plan)
        return self._first_controls(states)


BEHAVIOURS: dict[str, BehaviourFactory] = {"receding": Receding, "open_loop": OpenLoop}
"""Behaviours by name."""
