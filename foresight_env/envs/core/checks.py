"""Checks of what a user hands to an environment, before anything changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar, get_args

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float, Float32

from foresight_env.envs.core.behaviours import BEHAVIOURS, BehaviourFactory
from foresight_env.envs.core.world import World
from foresight_env.games import Game
from foresight_env.highway.ranges import DrivingRanges
from foresight_env.scenarios.crosswalk import Proximity, Ranges
from foresight_env.scenarios.episode_parameters import EpisodeParameters
from foresight_env.scenarios.junction import JunctionRanges

OPTIONS = ("gamma", "goals", "initial_state", "episode_parameters")
"""Entries that `reset` takes."""


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """An integer argument within limits."""
    fits = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
    if not fits or (most is not None and int(value) > most):
        limits = f"at least {least}" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name}: is {value!r}; expected an integer {limits}")
    return int(value)


def not_negative(name: str, value: Any) -> float:
    """A finite number that is at least 0."""
    if not isinstance(value, Real) or not 0.0 <= float(value) < np.inf:
        raise ValueError(f"{name}: is {value!r}; expected a finite number, at least 0")
    return float(value)


def choice(name: str, value: Any, choices: Sequence[str | None]) -> Any:
    """One of a few values."""
    if not (value is None or isinstance(value, str)) or value not in choices:
        raise ValueError(f"{name}: is {value!r}; expected one of {', '.join(map(repr, choices))}")
    return value


def check_proximity(value: Any) -> Proximity:
    """A variant of the game."""
    variant: Proximity = choice("proximity", value, get_args(Proximity))
    return variant


def check_controlled(controlled: Any, players: int) -> tuple[int, ...]:
    """Indices of controlled players in ascending order; None and "all" mean all players."""
    if controlled is None or controlled == "all":
        return tuple(range(players))
    cure = f"expected different indices from 0 to {players - 1}, at least one, or 'all'"
    if isinstance(controlled, (str, bytes)) or not isinstance(controlled, Sequence):
        raise ValueError(f"controlled: is {controlled!r}; {cure}")
    for player in controlled:
        if (
            not isinstance(player, Integral)
            or isinstance(player, bool)
            or player not in range(players)
        ):
            raise ValueError(f"controlled: contains {player!r}; {cure}")
    indices = tuple(sorted({int(player) for player in controlled}))
    if not indices or len(indices) != len(controlled):
        raise ValueError(f"controlled: is {controlled!r}; {cure}")
    return indices


def check_behaviour(behaviour: Any) -> BehaviourFactory:
    """A behaviour by name, or a user's factory."""
    if callable(behaviour):
        factory: BehaviourFactory = behaviour
        return factory
    return BEHAVIOURS[choice("behaviour", behaviour, tuple(BEHAVIOURS))]


R = TypeVar("R", Ranges, JunctionRanges, DrivingRanges)


def check_ranges(ranges: Any, kind: type[R]) -> R:
    """Check ranges of a scenario: every draw from them is a legal episode."""
    if not isinstance(ranges, kind):
        raise ValueError(f"ranges: is {ranges!r}; expected {kind.__module__}.{kind.__name__}")
    ranges.check()
    return ranges


def check_seed(seed: Any) -> int | None:
    """None or a seed."""
    return None if seed is None else whole("seed", seed, 0)


def _numbers(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value)
    except ValueError as error:
        raise ValueError(f"{name}: is not an array; expected shape {shape}") from error
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: is not numeric (type {array.dtype}); expected shape {shape}")
    if array.shape != shape:
        raise ValueError(f"{name}: has shape {array.shape}; expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: contains NaN or infinity; expected finite numbers")
    return array.astype(float)


def check_gamma(name: str, value: Any, world: World) -> Float[np.ndarray, "N"]:
    """Discount factors, each within the limits of its player's discounting."""
    gamma = _numbers(name, value, (world.players,))
    for i, player in enumerate(world.game(1).players):
        least, most = player.discounting.limits
        if not least <= gamma[i] <= most:
            kind = type(player.discounting).__name__
            raise ValueError(
                f"{name}[{i}]: is {gamma[i]:g}; {kind} discounting takes {least:g} to {most:g}"
            )
    return gamma


def check_positions(name: str, value: Any, world: World) -> Float[np.ndarray, "N 2"]:
    """Positions inside the observation space, m."""
    places = _numbers(name, value, (world.players, 2))
    low, high = world.shown_low[:, :2], world.shown_high[:, :2]
    if ((places < low) | (places > high)).any():
        raise ValueError(f"{name}: lies outside {low[0]} to {high[0]} m; bring it closer")
    return places


def check_states(name: str, value: Any, world: World) -> Float[np.ndarray, "N n"]:
    """Initial states: places that are shown, legal speeds, no overlap, on the road."""
    states = _numbers(name, value, world.shown_low.shape)
    check_positions(name, states[:, :2], world)
    game = world.game(1)
    for i, player in enumerate(game.players):
        low, high = world.shown_low[i, 2:], world.shown_high[i, 2:]
        if player.state_bounds is not None:
            low = np.maximum(low, player.state_bounds.lower[0][2:])
            high = np.minimum(high, player.state_bounds.upper[0][2:])
        if ((states[i, 2:] < low) | (states[i, 2:] > high)).any():
            raise ValueError(
                f"{name}: {world.names[i]} has {states[i, 2:]} after its position; expected "
                f"{low} to {high}"
            )
    gaps = world.gaps(
        states, np.zeros((world.players, game.players[0].dynamics.control_size)), states
    )
    if (gaps < 0.0).any():
        i, j = (int(k) for k in np.argwhere(gaps < 0.0)[0])
        raise ValueError(
            f"{name}: {world.names[i]} and {world.names[j]} begin {-gaps[i, j]:.2f} m inside each "
            "other, which is a collision; move one of them"
        )
    astray = np.flatnonzero(world.off_road(states))
    if astray.size:
        raise ValueError(f"{name}: {world.names[astray[0]]} begins off the road; move it")
    return states


def check_episode_parameters(value: Any, world: World) -> EpisodeParameters:
    """An episode's hidden truth, as a copy."""
    if not isinstance(value, EpisodeParameters):
        raise ValueError(
            f"options['episode_parameters']: is {value!r}; expected "
            "foresight_env.scenarios.episode_parameters.EpisodeParameters"
        )
    if not isinstance(value.theta, Sequence) or len(value.theta) != world.players:
        raise ValueError(
            f"options['episode_parameters'].theta: expected {world.players} mappings, one per "
            "player"
        )
    thetas = []
    for i, (theta, parameters) in enumerate(zip(value.theta, world.parameters(), strict=True)):
        name = f"options['episode_parameters'].theta[{i}]"
        if not isinstance(theta, Mapping) or set(theta) != set(parameters):
            raise ValueError(f"{name}: expected a mapping with exactly {sorted(parameters)}")
        own: dict[str, Any] = {}
        for k, shape in parameters.items():
            own[k] = _numbers(f"{name}[{k!r}]", theta[k], shape)
            if shape:
                continue  # places: they may be anywhere
            own[k] = float(own[k])
            if own[k] <= 0.0:
                raise ValueError(f"{name}[{k!r}]: is {own[k]}; expected more than 0")
        thetas.append(own)
    check_positions(
        "options['episode_parameters'].theta: goal", [own["goal"] for own in thetas], world
    )
    return EpisodeParameters(
        check_states("options['episode_parameters'].initial_state", value.initial_state, world),
        tuple(thetas),
        check_gamma("options['episode_parameters'].gamma", value.gamma, world),
    )


def check_options(options: Any, world: World) -> dict[str, Any]:
    """The options of `reset`, checked and copied."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"options: is {options!r}; expected a mapping with any of {OPTIONS}")
    # PettingZoo's own parallel_api_test passes exactly this to see that reset takes options.
    if set(options) == {"options"} and type(options["options"]) is int and options["options"] == 1:
        return {}
    checks: dict[str, Callable[[str, Any], Any]] = {
        "episode_parameters": lambda _, value: check_episode_parameters(value, world),
        "gamma": lambda name, value: check_gamma(name, value, world),
        "goals": lambda name, value: check_positions(name, value, world),
        "initial_state": lambda name, value: check_states(name, value, world),
    }
    for name in options:
        if name not in checks:
            raise ValueError(f"options: has no entry {name!r}; expected any of {OPTIONS}")
    return {name: checks[name](f"options[{name!r}]", value) for name, value in options.items()}


def with_options(drawn: EpisodeParameters, options: Mapping[str, Any]) -> EpisodeParameters:
    """Return the drawn episode changed by checked options; single entries win."""
    states, thetas, gamma = options.get("episode_parameters", drawn)
    if "goals" in options:
        goals = options["goals"]
        thetas = tuple({**t, "goal": goal} for t, goal in zip(thetas, goals, strict=True))
    return EpisodeParameters(
        options.get("initial_state", states), thetas, options.get("gamma", gamma)
    )


def control_limits(
    game: Game, player: int
) -> tuple[Float32[np.ndarray, "m"], Float32[np.ndarray, "m"]]:
    """Lowest and highest controls of a player of an environment, all bounded."""
    bounds = game.players[player].control_bounds
    assert bounds is not None
    return np.array(bounds.lower[0], np.float32), np.array(bounds.upper[0], np.float32)


def check_actions(
    actions: Any, spaces: Mapping[str, Box], agents: Sequence[str]
) -> dict[str, Float[np.ndarray, "m"]]:
    """One legal action per live agent."""
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions: is a {type(actions).__name__}; expected a dictionary from agent to action"
        )
    for agent in actions:
        if agent not in agents:
            raise ValueError(
                f"actions: names {agent!r}, which is not a live agent; give actions for "
                f"{', '.join(agents)} only"
            )
    checked = {}
    for agent in agents:
        space = spaces[agent]
        if agent not in actions:
            raise ValueError(f"actions: {agent} has none; give it an array {space.shape}")
        action = _numbers(f"actions[{agent!r}]", actions[agent], space.shape)
        if ((action < space.low) | (action > space.high)).any():
            raise ValueError(
                f"actions[{agent!r}]: is {action}, outside the action space; clip it to "
                f"{space.low} ... {space.high}"
            )
        checked[agent] = action
    return checked
