"""Conformance tests for custom predictors and egos.

    from agents.conformance import check_ego, check_predictor

    check_predictor(MyPredictor())
    check_ego(MyEgo())

Each runs the agent on small cases and raises `ConformanceError` with what was found and what was
expected. They test the interface, not the performance: `foresight benchmark` does that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from agents.egos.predict_then_plan import context_of
from agents.interfaces.policy import EgoPolicy
from agents.interfaces.predictor import Context, History, Predictor
from foresight_env.envs.crosswalk_v0 import parallel_env
from foresight_env.games.kinds import kind_of

PROBABILITY_TOLERANCE = 1e-5
"""By how much probabilities may miss one in sum: single precision is allowed."""
FARTHEST = 5.0
"""No first predicted position is farther from the agent's last observed one than this (m) and three
times the way that it makes in a step: else it was not predicted in the axes of the history."""


class ConformanceError(AssertionError):
    """An agent violates its protocol; the message says what and where."""


def _require(holds: Any, case: str, what: str) -> None:
    if not holds:
        raise ConformanceError(f"{case}: {what}")


def histories() -> Iterator[tuple[str, History]]:
    """Named cases: classes, gaps, late comers, a single step, another rate, far from the origin."""
    walking, late = np.array([1.2, 0.3]), np.array([-0.8, 0.9])
    driving, still = np.array([6.0, 0.5]), np.zeros(2)
    people = ("pedestrian", "pedestrian")
    yield "two pedestrians", _straight([walking, late], people)
    yield "a car and a pedestrian", _straight([driving, walking], ("car", "pedestrian"))
    yield "one agent", _straight([walking], ("pedestrian",))
    kinds = ("bicycle", "car", "pedestrian", "truck")
    yield "four agents, one stands", _straight([walking, driving, still, driving], kinds)
    yield "a single observation", _straight([walking, driving], ("pedestrian", "car"), steps=1)
    yield "steps of 0.1 s", _straight([walking, late], people, dt=0.1)
    gaps = _straight([walking, driving], ("pedestrian", "car"))
    gaps.states[:3, 0] = gaps.states[4, 1] = np.nan
    gaps.headings[4, 1] = np.nan
    yield "unseen at times", gaps
    gone = _straight([walking, late], people)
    gone.states[-1, 1] = np.nan
    yield "unseen at the end", gone
    yield "far from the origin", _straight([walking, late], people, about=(4000.0, -2500.0))


def context_histories() -> Iterator[tuple[str, History]]:
    """Named cases with a context: a car's route, and a crosswalk of two with its game."""
    routes = tuple(
        np.column_stack([along, np.full((60, 1), y), np.zeros((60, 2))])
        for along, y in ((np.arange(-20.0, 40.0)[:, None], y) for y in (0.0, 3.5))
    )
    drive = _straight([np.array([6.0, 0.0]), np.array([1.2, 0.3])], ("car", "pedestrian"))
    yield "a car on a route", replace(drive, context=Context(routes, np.array([3.0, 1.0])))
    yield from game_histories()


def game_histories() -> Iterator[tuple[str, History]]:
    """Named cases of the environment crosswalk, with its game in the context."""
    scene = parallel_env(controlled=(0,), planning_horizon=10, noise_std=0.05).scene
    context = context_of(scene)
    velocities, every = [np.array([-0.5, -0.6]), np.array([0.6, -0.5])], 4
    walk = _straight(velocities, ("pedestrian", "pedestrian"), steps=4, dt=every * scene.dt)
    walk.states[:, :, :2] += np.array([[2.0, 2.0], [0.0, -2.0]])
    yield "a crosswalk with its game", replace(walk, context=context)
    gaps = replace(walk, states=walk.states.copy(), context=context)
    gaps.states[1, 0] = gaps.states[3, 1] = np.nan
    yield "a crosswalk with its game, unseen at times", gaps
    first = replace(
        walk, states=walk.states[:1].copy(), headings=walk.headings[:1].copy(), context=context
    )
    yield "a crosswalk with its game, a single observation", first


def _straight(
    velocities: list[np.ndarray],
    kinds: tuple[str, ...],
    *,
    steps: int = 8,
    dt: float = 0.4,
    about: tuple[float, float] = (0.0, 0.0),
) -> History:
    """Agents in straight motion, 4 m apart."""
    count, times = len(kinds), dt * np.arange(steps)[:, None, None]
    states = np.empty((steps, count, 4))
    states[..., 2:] = np.stack(velocities)
    begin = np.array(about) + np.outer(np.arange(count), [0.0, 4.0])
    states[..., :2] = begin + times * states[..., 2:]
    headings = np.full((steps, count), np.nan)
    extents = np.full((count, 2), np.nan)
    for i, kind in enumerate(kinds):
        if kind != "pedestrian":
            headings[:, i] = np.arctan2(*velocities[i][::-1])
            extents[i] = kind_of(kind).length, kind_of(kind).width
    return History(states, headings, kinds, extents, dt)


def check_predictor(
    predictor: Predictor, cases: Iterable[tuple[str, History]] | None = None
) -> None:
    """Whether a predictor does what `Predictor` and `Forecast` say; `ConformanceError` if not.

    Shapes, finite numbers, probabilities, covariances, that the history is left as it was, that the
    same history has the same forecast, and that forecasts are in the history's axes. `cases`: named
    histories, default those of `histories`, without a context, and of `context_histories`. Of a
    predictor that needs the game of the place: `game_histories`.
    """
    _check_name(predictor)
    _require(callable(getattr(predictor, "predict", None)), "predictor", "has no method `predict`")
    given = chain(histories(), context_histories()) if cases is None else cases
    for k, (case, history) in enumerate(given):
        for steps in (1, 10) if k == 0 else (10,):
            before = [np.array(a) for a in (history.states, history.headings, history.extents)]
            found = predictor.predict(history, steps)
            after = history.states, history.headings, history.extents
            _require(
                all(np.array_equal(a, b, True) for a, b in zip(before, after, strict=True)),
                case,
                "predict changed the history; work on a copy",
            )
            check_forecast(found, history, steps, case)
            again = predictor.predict(history, steps)
            _require(
                np.array_equal(again.positions, found.positions),
                case,
                "the same history had another forecast; draw from a generator with a fixed seed",
            )


def check_forecast(found: Any, history: History, steps: int, case: str = "forecast") -> None:
    """Whether a forecast of this history fits it; `ConformanceError` if not."""
    agents = len(history.kinds)
    positions, probabilities = (
        _array(getattr(found, name, None), case, name) for name in ("positions", "probabilities")
    )
    modes = len(probabilities) if probabilities.ndim else 0
    _require(probabilities.ndim == 1 and modes > 0, case, "probabilities: expected shape (M,)")
    _shape(positions, (modes, steps, agents, 2), case, "positions", "(M, steps, N, 2)")
    _require(
        (probabilities >= 0.0).all() and abs(probabilities.sum() - 1) < PROBABILITY_TOLERANCE,
        case,
        f"probabilities: are {probabilities}; expected none below 0, and a sum of 1",
    )
    if found.covariance is not None:
        covariance = _array(found.covariance, case, "covariance")
        _shape(covariance, (modes, steps, agents, 2, 2), case, "covariance", "(M, steps, N, 2, 2)")
        scale = max(1.0, float(np.abs(covariance).max()))
        even = np.allclose(covariance, np.swapaxes(covariance, -1, -2), atol=1e-6 * scale)
        least = float(np.linalg.eigvalsh(covariance).min())
        _require(
            even and least > -1e-6 * scale,
            case,
            f"covariance: has an eigenvalue {least:.2g}, or is not symmetric; expected symmetric "
            "matrices without negative eigenvalues",
        )
    for name in ("gamma", "gamma_deviation", "gamma_identifiable"):
        value = getattr(found, name, None)
        if value is not None:
            _shape(_array(value, case, name), (agents,), case, name, "(N,)")
    for i in range(agents):
        last = history.states[history.seen(i)[-1], i]
        missing = len(history.states) - history.seen(i)[-1]
        reach = FARTHEST + 3.0 * missing * history.dt * float(np.hypot(*last[2:]))
        away = np.linalg.norm(positions[:, 0, i] - last[:2], axis=1)
        _require(
            (away <= reach).all(),
            case,
            f"positions: agent {i} is {away.max():.1f} m from where it was last observed after one "
            f"step; expected at most {reach:.1f} m, in the axes of the history",
        )


def check_ego(
    policy: EgoPolicy[Any],
    make_environment: Callable[[], Any] | None = None,
    *,
    steps: int = 6,
    blind: bool = True,
) -> None:
    """Whether an ego does what `EgoPolicy` and `Decision` say; `ConformanceError` if not.

    `make_environment`: makes a parallel environment with one controlled agent; default: a crosswalk
    of two. Checked for `steps` steps: actions inside the action space, shapes of plans and
    predictions, that everything it remembers is in its memory (two episodes at once go as they do
    one after the other), and with `blind` that nothing depends on the truth in `info`.
    """
    make = make_environment or _crosswalk
    _check_name(policy)
    for name in ("init", "update", "act"):
        _require(callable(getattr(policy, name, None)), "ego", f"has no method `{name}`")
    apart = [_drive(policy, make(), seed, steps) for seed in (0, 1)]
    first, second = (_Episode(policy, make(), seed) for seed in (0, 1))
    for k in range(steps):
        for episode, alone in ((first, apart[0]), (second, apart[1])):
            if k < len(alone):
                _require(
                    np.array_equal(episode.step().action, alone[k].action),
                    f"step {k}",
                    "two episodes at once have other actions than one after the other; keep "
                    "everything that changes in the memory, and draw from a fixed seed",
                )
    if blind:
        without_truth = _drive(policy, make(), 0, steps, lambda info: dict.fromkeys(info))
        _require(
            all(
                np.array_equal(a.action, b.action)
                for a, b in zip(without_truth, apart[0], strict=True)
            ),
            "info",
            "without the truth in `info` the actions are others; only an oracle may look at it "
            "(blind=False)",
        )


class _Episode:
    """An ego in an environment, step by step, each decision checked."""

    def __init__(
        self,
        policy: EgoPolicy[Any],
        env: Any,
        seed: int,
        hidden: Callable[[Mapping[str, Any]], Mapping[str, Any]] = dict,
    ) -> None:
        self.policy, self.env, self.hidden = policy, env, hidden
        self.observations, self.infos = env.reset(seed=seed)
        (self.agent,) = env.agents
        self.space = env.action_space(self.agent)
        self.memory = policy.init(env.scene, self.agent)
        self.taken = 0

    def step(self) -> Any:
        """The next decision, carried out."""
        case, agent = f"step {self.taken}", self.agent
        info = self.hidden(self.infos[agent])
        self.memory = self.policy.update(self.memory, self.observations[agent], info)
        decision, self.memory = self.policy.act(self.memory)
        self._check(decision, case)
        self.observations, *_, self.infos = self.env.step({agent: decision.action})
        self.taken += 1
        return decision

    def _check(self, decision: Any, case: str) -> None:
        action = np.asarray(decision.action)
        _require(
            self.space.contains(action),
            case,
            f"action: is {action} ({action.dtype}, shape {action.shape}); expected one of "
            f"{self.space} from {self.space.low} to {self.space.high}",
        )
        players = self.env.scene.players
        if decision.planned is not None:
            _path(decision.planned, case, "planned")
        for name in ("predicted", "gammas"):
            value = getattr(decision, name)
            _require(
                isinstance(value, Mapping) and all(j in range(players) for j in value),
                case,
                f"{name}: expected a dict by player, 0 to {players - 1}",
            )
        for j, path in decision.predicted.items():
            _path(path, case, f"predicted[{j}]")
        for j, belief in decision.gammas.items():
            mean, deviation = belief
            _require(
                np.isfinite(mean) and deviation >= 0.0,
                case,
                f"gammas[{j}]: is {belief}; expected a finite mean and a deviation not below 0",
            )


def _drive(
    policy: EgoPolicy[Any],
    env: Any,
    seed: int,
    steps: int,
    hidden: Callable[[Mapping[str, Any]], Mapping[str, Any]] = dict,
) -> list[Any]:
    episode = _Episode(policy, env, seed, hidden)
    found: list[Any] = []
    while env.agents and len(found) < steps:
        found.append(episode.step())
    return found


def _crosswalk() -> Any:
    return parallel_env(controlled=(0,), planning_horizon=10, noise_std=0.02)


def _check_name(agent: Any) -> None:
    name = getattr(agent, "name", None)
    _require(isinstance(name, str) and name, "name", f"is {name!r}; expected a text that is shown")


def _array(value: Any, case: str, name: str) -> np.ndarray:
    _require(
        isinstance(value, np.ndarray),
        case,
        f"{name}: is a {type(value).__name__}; expected a NumPy array",
    )
    _require(np.isfinite(value).all(), case, f"{name}: holds NaN or infinity")
    return np.asarray(value)


def _shape(
    value: np.ndarray, shape: tuple[int, ...], case: str, name: str, expectation: str
) -> None:
    _require(
        value.shape == shape,
        case,
        f"{name}: has shape {value.shape}; expected {shape}, {expectation}",
    )


def _path(value: Any, case: str, name: str) -> None:
    path = _array(value, case, name)
    _require(
        path.ndim == 2 and path.shape[1] == 2,
        case,
        f"{name}: has shape {path.shape}; expected (K, 2), positions in m",
    )
