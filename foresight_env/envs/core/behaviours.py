"""Behaviours of uncontrolled agents: an equilibrium of the game, or any other that one adds.

A behaviour gets the true states of all agents, once per step, and answers with controls. The two
here are the *oracle*: they know every player's true parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
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


class JointPlan(NamedTuple):
    """Plan of all players from the present state on."""

    states: Float[np.ndarray, "N stages n"]
    """The present state and those after stages 1..T."""
    controls: Float[np.ndarray, "N T m"]
    """Of stages 1..T."""
    solved: bool = True
    """Whether it is an equilibrium from here on; False: what is left of an earlier one."""


class BehaviourSetting(NamedTuple):
    """Game and limits of a behaviour; the same during the whole life of an environment."""

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

    def plan(self, states: Float[np.ndarray, "N n"]) -> JointPlan | None:
        """Return the plan that the next `act`, at the same true `states`, follows; None: no plan.

        Called at most once before each `act`. It does not change `report` or `planned`.
        """

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of all players at the true `states`; called once per step.

        The environment uses the rows of uncontrolled agents.
        """


BehaviourFactory = Callable[[BehaviourSetting], Behaviour]
"""Makes a behaviour; a class with a constructor of this form is one."""


class _Next(NamedTuple):
    """Plan that the next `act` follows and reports, computed before it."""

    states: Float[np.ndarray, "N n"]
    solution: Solution | None
    report: SolverReport


class _Oracle(ABC):
    """Base of both oracles: a game, an episode's parameters and a plan that may be missing."""

    def __init__(self, game: Game) -> None:
        self._game = game
        self._episode: EpisodeParameters | None = None
        self._plan: Solution | None = None
        self._report = SolverReport()
        self._next: _Next | None = None

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
        self._next = None

    def plan(self, states: Float[np.ndarray, "N n"]) -> JointPlan | None:
        """Return the equilibrium, or what is left of an earlier one where the solve failed."""
        self._next = self._following(states)
        solution = self._next.solution
        if solution is None:
            return None
        return JointPlan(
            np.stack([np.array(x) for x in solution.states]),
            np.stack([np.array(u) for u in solution.controls]),
            self._next.report.failures == self._report.failures,
        )

    def act(self, states: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        """Controls of the first stage of the plan at `states`."""
        following = self._next
        if following is None or not np.array_equal(following.states, states):
            following = self._following(states)
        self._plan, self._report, self._next = following.solution, following.report, None
        if self._plan is None:
            return brake(self._game, states)
        return np.stack([controls[0] for controls in self._plan.controls])

    @abstractmethod
    def _following(self, states: Float[np.ndarray, "N n"]) -> _Next:
        """Return the plan from `states` on; changes nothing."""

    def _solve(
        self, states: Float[np.ndarray, "N n"], initial_guess: Solution | None
    ) -> tuple[Solution | None, SolverReport]:
        """Return a solution, None where the solve failed, and the report with this solve."""
        if self._episode is None:
            raise RuntimeError("act: there is no episode; call reset first")
        _, theta, gamma = self._episode
        found = solve(self._game, states, theta, gamma, initial_guess=initial_guess)
        solved = int(found.status) == Status.SOLVED
        residual = float(found.residual)
        report = SolverReport(
            int(found.status),
            residual if np.isfinite(residual) else float("inf"),
            self._report.failures + (not solved),
        )
        return (found if solved else None), report


class Receding(_Oracle):
    """Re-solves the game of all players at every step and plays the first stage of the solution.

    Each solve starts from the previous solution, shifted by one stage. When it fails, the shifted
    plan is played on; without one, all agents brake to rest.
    """

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting.game(setting.planning_horizon))

    def _following(self, states: Float[np.ndarray, "N n"]) -> _Next:
        shifted = None if self._plan is None else shift(self._plan)
        found, report = self._solve(states, shifted)
        return _Next(states.copy(), shifted if found is None else found, report)


class OpenLoop(_Oracle):
    """Solves the game over the whole episode once, at its first step, and follows the plan.

    When that solve fails, all agents brake to rest and stay there.
    """

    def __init__(self, setting: BehaviourSetting) -> None:
        super().__init__(setting.game(setting.max_steps))

    def _following(self, states: Float[np.ndarray, "N n"]) -> _Next:
        if self._report.status == NOTHING_SOLVED:
            return _Next(states.copy(), *self._solve(states, None))
        shifted = None if self._plan is None else shift(self._plan)
        return _Next(states.copy(), shifted, self._report)


BEHAVIOURS: dict[str, BehaviourFactory] = {"receding": Receding, "open_loop": OpenLoop}
"""Behaviours by name."""
