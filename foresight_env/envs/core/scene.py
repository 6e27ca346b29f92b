"""Information for an agent's policy: all that is public, and the agent's own parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded
from jaxtyping import Array, Float

from foresight_env.annotations import no_type_check
from foresight_env.games import Game, ObservationModel, full_state, positions
from foresight_env.games.footprints import Footprint
from foresight_env.games.types import States
from foresight_env.names import Observation


def scene_of(env: Any) -> Scene:
    """Return the present episode's `Scene` of an environment in any wrappers.

    The typed form of `env.unwrapped.scene`, whose `scene` type checkers do not know: Gymnasium's
    `make` and PettingZoo's wrappers return environments in general.

    Args:
        env: an environment of this library, such as `gymnasium.make("foresight/Crosswalk-v0")`.

    Returns:
        The scene since the last `reset`.

    Raises:
        ValueError: it is no environment of this library with a scene.
    """
    scene = getattr(getattr(env, "unwrapped", env), "scene", None)
    if not isinstance(scene, Scene):
        raise ValueError(
            f"env: is {env!r}; expected an environment of foresight_env for one agent, or a "
            "parallel one"
        )
    return scene


class Own(NamedTuple):
    """One player's own parameters in the current episode."""

    theta: dict[str, Any]
    """As `player_theta` makes it."""
    gamma: float


@dataclass(frozen=True)
class _InOrder:
    """`model` on the players in another order."""

    model: ObservationModel
    order: tuple[int, ...]

    def __call__(self, states: States) -> Float[Array, "size"]:
        return self.model(tuple(states[j] for j in self.order))


def observation_order(player: int, players: int) -> tuple[int, ...]:
    """Players in the order in which `player` observes them: itself first, then by index."""
    return (player, *(j for j in range(players) if j != player))


def own_first(observation: Observation, game: Game, player: int) -> ObservationModel:
    """Observation model of `player`, without the goal at the end."""
    order = observation_order(player, len(game.players))
    model = (full_state if observation == "full" else positions)(game.state_sizes)
    owners = tuple(None if k is None else order[k] for k in model.owners)
    return ObservationModel(_InOrder(model, order), owners)


class OpponentPrior(NamedTuple):
    """Prior about another player of which only the track is known."""

    free: tuple[str, ...]
    """Entries of its `theta` that are worth estimating."""
    deviation: tuple[tuple[str, float], ...]
    """Of those, by how much a first guess may be off (standard deviations)."""
    guesses: Callable[
        [dict[str, Any], Float[np.ndarray, "K 2"], Float[np.ndarray, "4"]],
        tuple[dict[str, Any], ...],
    ]
    """From the ego's own `theta`, the other's recent positions (the newest last, m) and its present
    state: every possible `theta` of the other, one per route where several are possible, the most
    likely first. Entries that are not in `free` may be guessed again at every step."""

    def guess(
        self, own: dict[str, Any], track: Float[np.ndarray, "K 2"], state: Float[np.ndarray, "4"]
    ) -> dict[str, Any]:
        """Return the most likely of `guesses`."""
        return self.guesses(own, track, state)[0]


def _stays(
    own: dict[str, Any], track: Float[np.ndarray, "K 2"], state: Float[np.ndarray, "4"]
) -> tuple[dict[str, Any]]:
    """The same weights, and a goal where it is."""
    return ({**own, "goal": np.array(track[-1])},)


GOALS = OpponentPrior(("goal",), (("goal", 3.0),), _stays)
"""Others have the ego's weights and unknown goals."""


LEAST_DEVIATION = 1e-2
"""Of an entry that does not differ between episodes (m, m/s)."""


class Population(NamedTuple):
    """Prior of a place's agents before any of them is observed.

    It is what a network learns from episodes of other seeds: where agents of this place usually go,
    with which weights, and in which range their discount factors lie.
    """

    theta: tuple[dict[str, Any], ...]
    """Usual parameters, per player."""
    deviation: tuple[tuple[str, float], ...]
    """Standard deviations of the entries of `theta` that differ between episodes."""
    gamma: tuple[float, float]
    """Range of discount factors."""

    @staticmethod
    def drawn_uniformly(
        theta: tuple[dict[str, Any], ...], name: str, largest: float, gamma: tuple[float, float]
    ) -> Population:
        """Return the prior where the entry `name` is at most `largest` off, uniformly.

        Args:
            theta: usual parameters, per player.
            name: the entry that differs between episodes.
            largest: its largest difference (m or m/s).
            gamma: range of discount factors.
        """
        deviation = max(largest / np.sqrt(3.0), LEAST_DEVIATION)
        return Population(theta, ((name, float(deviation)),), gamma)


@dataclass(frozen=True)
class Scene:
    """An environment as its agents may know it; a new one for each episode."""

    game: Game
    """The game over the planning horizon."""
    observation: Observation
    noise_std: float
    """Standard deviation of every observed coordinate, m and m/s."""
    controlled: tuple[int, ...]
    """Players that the user controls."""
    max_steps: int
    names: tuple[str, ...]
    """Of all players' agents."""
    goal_radius: tuple[float, ...]
    """Per player, distance from its goal within which an agent has reached it, m."""
    footprints: tuple[Footprint, ...]
    """Of all players: what they cover around their positions."""
    opponent_prior: OpponentPrior = field(default=GOALS, repr=False)
    """Prior of every agent about others."""
    population: Population | None = field(default=None, repr=False)
    """Prior of the place's agents; None where the scenario states none."""
    routes: tuple[Float[np.ndarray, "_ 4"], ...] = field(default=(), repr=False)
    """Centre lines of vehicles' routes: points `[px, py, heading, curvature]`, 1 m apart (m, rad,
    1/m)."""
    _own: Mapping[int, Own] = field(default_factory=dict, repr=False)

    @property
    def players(self) -> int:
        """How many agents there are, controlled or not."""
        return len(self.game.players)

    @property
    def dt(self) -> float:
        """Duration of a step, s."""
        return self.game.dt

    def index(self, agent: str | int) -> int:
        """The player of a controlled agent, which is given by name or index."""
        for player in self.controlled:
            if agent in (player, self.names[player]) and not isinstance(agent, bool):
                return player
        names = ", ".join(self.names[player] for player in self.controlled)
        raise ValueError(f"agent: {agent!r} is not controlled; controlled agents are {names}")

    def observation_model(self, agent: str | int) -> ObservationModel:
        """`h` of one agent, noise and the goal at the end left out.

        It maps the players' states, in the order of their indices, to what this agent sees: itself
        first, then the others in the order of their indices.
        """
        return own_first(self.observation, self.game, self.index(agent))

    def own(self, agent: str | int) -> Own:
        """A controlled agent's own parameters in the current episode."""
        player = self.index(agent)
        if player not in self._own:
            raise ResetNeeded(
                "scene.own: this scene was taken before reset; call reset, then take env.scene "
                "again, and then init the policy with it"
            )
        return deepcopy(self._own[player])

    @no_type_check
    def check_episode(
        self, agent: str | int, observation: Float[np.ndarray, "size"], info: Mapping[str, Any]
    ) -> None:
        """Check that what an agent is shown belongs to this scene's episode.

        An episode is known by the agent's own parameters: the goal at the end of its observations
        and, where `info` has them, its own entries of `gamma` and `theta`.

        Args:
            agent: a controlled agent.
            observation: (size,) as the environment returns it, the goal at its end.
            info: the environment's information, which may lack entries.

        Raises:
            ValueError: the observation has another shape, or the parameters are another episode's.
        """
        player = self.index(agent)
        expected = (self.observation_model(player).size + 2,)
        if np.shape(observation) != expected:
            raise ValueError(
                f"observation: has shape {np.shape(observation)}; expected {expected}, as the "
                "environment returns it"
            )
        if not isinstance(info, Mapping):
            raise ValueError(f"info: is {info!r}; expected a mapping, as the environment returns")
        own = self._own.get(player)
        if own is None:
            return
        shown = {"observation: goal": (observation[-2:], own.theta["goal"])}
        if info.get("gamma") is not None:
            shown["info: gamma"] = info["gamma"][player], own.gamma
        if info.get("theta") is not None:
            told = info["theta"]
            for name, value in own.theta.items():
                if name in told:
                    shown[f"info: theta[{name!r}]"] = told[name][player], value
        for name, (found, value) in shown.items():
            # A goal that is not observed is NaN; single precision is allowed.
            missing = np.isnan(found)
            if not (missing | np.isclose(found, value, rtol=1e-5, atol=1e-5)).all():
                raise ValueError(
                    f"{name} is {found}, but {value} in the scene: it is another episode's; take "
                    "env.scene after reset and init the policy with it"
                )
