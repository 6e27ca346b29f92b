"""Checks of what a user hands to an environment, before anything changes."""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar, get_args

import numpy as np
from jaxtyping import Float

from foresight_env.envs.oracle import BEHAVIOURS, BehaviourFactory
from foresight_env.scenarios.crosswalk import (
    COLLISION_DISTANCE,
    CONTROL_LIMIT,
    SPEED_LIMIT,
    Crossing,
    Proximity,
    Ranges,
    player_theta,
)

T = TypeVar("T", bound=Callable[..., Any])


def no_type_check(checked: T) -> T:
    """Marks what checks its own arguments, so that run-time type checkers leave it alone.

    `typing` has a decorator of the same name, but with that one static checkers look away too.
    """
    marked: T = typing.no_type_check(checked)
    return marked


POSITION_LIMIT = 20.0
"""Largest coordinate that an observation can show, m."""
LARGEST_START_SHIFT = 0.35
"""Up to here agents around the circle cannot be drawn on top of each other, m."""
LARGEST_GOAL_SHIFT = 10.0
"""Keeps every goal inside the observation space, m."""
OPTIONS = ("crossing", "gamma", "goals", "initial_states")
"""Entries that `reset` takes."""
WEIGHTS = ("goal_weight", "control_weight", "collision_weight")


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
    """Indices of controlled players in ascending order; None and "all" mean everybody."""
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
    """A behaviour by name, or a factory of one's own."""
    if callable(behaviour):
        factory: BehaviourFactory = behaviour
        return factory
    return BEHAVIOURS[choice("behaviour", behaviour, tuple(BEHAVIOURS))]


def check_ranges(ranges: Any) -> Ranges:
    """Ranges whose every draw is a legal episode."""
    if not isinstance(ranges, Ranges):
        raise ValueError(
            f"ranges: is {ranges!r}; expected foresight_env.scenarios.crosswalk.Ranges"
        )
    for name in ("gamma", "control_weight", "collision_weight"):
        pair = getattr(ranges, name)
        positive = name != "gamma"
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError) as error:
            raise ValueError(f"ranges.{name}: is {pair!r}; expected (lowest, highest)") from error
        if not (0.0 <= low <= high < np.inf) or (positive and low == 0.0):
            least = "above 0" if positive else "at least 0"
            raise ValueError(
                f"ranges.{name}: is {pair!r}; expected lowest <= highest, finite and {least}"
            )
    for name, most in (("start", LARGEST_START_SHIFT), ("goal", LARGEST_GOAL_SHIFT)):
        if not_negative(f"ranges.{name}", getattr(ranges, name)) > most:
            raise ValueError(f"ranges.{name}: is {getattr(ranges, name)!r}; at most {most} m")
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


def check_gamma(name: str, value: Any, players: int) -> Float[np.ndarray, "N"]:
    """Discount factors; above 1 is allowed."""
    gamma = _numbers(name, value, (players,))
    if (gamma < 0.0).any():
        raise ValueError(f"{name}: is {gamma}; discount factors are at least 0")
    return gamma


def check_positions(name: str, value: Any, players: int) -> Float[np.ndarray, "N 2"]:
    """Positions inside the observation space, m."""
    places = _numbers(name, value, (players, 2))
    if (np.abs(places) > POSITION_LIMIT).any():
        raise ValueError(f"{name}: lies outside +-{POSITION_LIMIT} m; bring it closer")
    return places


def check_states(name: str, value: Any, players: int) -> Float[np.ndarray, "N 4"]:
    """Initial states: positions inside the observation space, legal speeds, nobody overlapping."""
    states = _numbers(name, value, (players, 4))
    check_positions(name, states[:, :2], players)
    if (np.abs(states[:, 2:]) > SPEED_LIMIT).any():
        raise ValueError(f"{name}: a velocity exceeds {SPEED_LIMIT} m/s per axis; reduce it")
    for i in range(players):
        for j in range(i):
            if np.linalg.norm(states[i, :2] - states[j, :2]) < COLLISION_DISTANCE:
                raise ValueError(
                    f"{name}: players {j} and {i} begin less than {COLLISION_DISTANCE} m apart, "
                    "which is a collision; move one of them"
                )
    return states


def check_crossing(crossing: Any, players: int) -> Crossing:
    """An episode's hidden truth, as a copy."""
    if not isinstance(crossing, Crossing):
        raise ValueError(
            f"options['crossing']: is {crossing!r}; expected "
            "foresight_env.scenarios.crosswalk.Crossing"
        )
    if not isinstance(crossing.theta, Sequence) or len(crossing.theta) != players:
        raise ValueError(f"options['crossing'].theta: expected {players} mappings, one per player")
    thetas = []
    for i, theta in enumerate(crossing.theta):
        name = f"options['crossing'].theta[{i}]"
        entries = {"goal", *WEIGHTS}
        if not isinstance(theta, Mapping) or set(theta) != entries:
            raise ValueError(f"{name}: expected a mapping with exactly {sorted(entries)}")
        weights = {k: float(_numbers(f"{name}[{k!r}]", theta[k], ())) for k in WEIGHTS}
        for k, weight in weights.items():
            if weight <= 0.0:
                raise ValueError(f"{name}[{k!r}]: is {weight}; weights are above 0")
        goal = check_positions(f"{name}['goal']", [theta["goal"]], 1)[0]
        thetas.append(player_theta(goal, **weights))
    return Crossing(
        check_states("options['crossing'].initial_states", crossing.initial_states, players),
        tuple(thetas),
        check_gamma("options['crossing'].gamma", crossing.gamma, players),
    )


def check_options(options: Any, players: int) -> dict[str, Any]:
    """The options of `reset`, checked and copied."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"options: is {options!r}; expected a mapping with any of {OPTIONS}")
    # PettingZoo's own parallel_api_test passes exactly this to see that reset takes options.
    if set(options) == {"options"} and type(options["options"]) is int and options["options"] == 1:
        return {}
    checks: dict[str, Callable[[str, Any], Any]] = {
        "crossing": lambda _, value: check_crossing(value, players),
        "gamma": lambda name, value: check_gamma(name, value, players),
        "goals": lambda name, value: check_positions(name, value, players),
        "initial_states": lambda name, value: check_states(name, value, players),
    }
    for name in options:
        if name not in checks:
            raise ValueError(f"options: has no entry {name!r}; expected any of {OPTIONS}")
    return {name: checks[name](f"options[{name!r}]", value) for name, value in options.items()}


def with_options(drawn: Crossing, options: Mapping[str, Any]) -> Crossing:
    """The drawn episode with what checked options set; entries win over a whole `crossing`."""
    states, thetas, gamma = options.get("crossing", drawn)
    if "goals" in options:
        goals = options["goals"]
        thetas = tuple({**t, "goal": goal} for t, goal in zip(thetas, goals, strict=True))
    return Crossing(options.get("initial_states", states), thetas, options.get("gamma", gamma))


def check_actions(actions: Any, agents: Sequence[str]) -> dict[str, Float[np.ndarray, "2"]]:
    """One legal action per live agent, m/s^2."""
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions: is a {type(actions).__name__}; expected a dictionary from agent to [ax, ay]"
        )
    for agent in actions:
        if agent not in agents:
            raise ValueError(
                f"actions: names {agent!r}, which is not a live agent; give actions for "
                f"{', '.join(agents)} only"
            )
    checked = {}
    for agent in agents:
        if agent not in actions:
            raise ValueError(f"actions: {agent} has none; give it [ax, ay] in m/s^2")
        action = _numbers(f"actions[{agent!r}]", actions[agent], (2,))
        if (np.abs(action) > CONTROL_LIMIT).any():
            raise ValueError(
                f"actions[{agent!r}]: is {action}, outside the action space; clip it to "
                f"[-{CONTROL_LIMIT:g}, {CONTROL_LIMIT:g}] m/s^2"
            )
        checked[agent] = action
    return checked
