"""Recorded encounters: infer on the first part, predict the rest, compare with what happened."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from evaluation.metrics import displacement
from foresight_env.datasets import (
    Interaction,
    Recording,
    closest_crossings,
    find_interaction,
    open_recording,
)
from foresight_env.equilibrium import Status
from foresight_env.games import full_state
from foresight_env.inverse import (
    Estimate,
    Free,
    MultiStart,
    Prior,
    estimate,
    guess_initial_states,
)
from foresight_env.scenarios.encounter import encounter_game, player_theta

STEP_SECONDS = 0.4
"""Wanted time between observations; UCY has exactly this, DUT is taken every tenth frame."""
OBSERVED = 9
"""Observations before the prediction starts: 3.2 s."""
PREDICTED = 10
"""Predicted steps: 4 s."""
LEAD_SECONDS = 2.0
"""The prediction starts this long before the first agent reaches the crossing point, or as soon as
both have been seen `LEAST_OBSERVED` times, whichever is later."""
LEAST_OBSERVED = 4
"""Observations of both agents without which nothing is predicted."""
LEAST_LEAD = STEP_SECONDS
"""Of pairs that the project picks itself: those that were seen together too late are no
predictions of the encounter."""
METHODS = ("foresight", "farsighted", "constant velocity")

NOISE_STD = 0.03
"""Standard deviation of a recording's positions and velocities, m and m/s."""
AGING = 1.8
"""By how much the deviation grows per step into the past: people change their minds, so old
observations say less of what they want now. Chosen, with `NOISE_STD` and `PRIOR`, on DUT clips
intersection_01, _03, _13 and _17."""
PRIOR = Prior(gamma_weight=4.0, gamma_center=1.0, theta_deviation=(("velocity", 0.2),))
"""Weak beliefs: discount factors 1 +- 0.5, wanted velocities within 0.2 m/s of the last seen."""


@dataclass(frozen=True)
class Forecast:
    """One method's prediction of one encounter, with its errors (m)."""

    method: str
    agents: tuple[str, ...]
    predicted: Float[np.ndarray, "P A 2"]
    """Predicted positions of the steps after the observations."""
    average_error: float
    final_error: float
    gamma: Float[np.ndarray, "A"] | None
    gamma_deviation: Float[np.ndarray, "A"] | None
    """0 where a discount factor rests on a limit of the search, or was not inferred."""
    gamma_determined: Bool[np.ndarray, "A"] | None
    """False where the observations leave a discount factor open."""
    solved: bool
    """False when the fit failed and the prediction is constant velocity instead."""


@dataclass(frozen=True)
class Encounter:
    """A window of a recording: what is given to predictors, and what happened."""

    recording: str
    interaction: Interaction
    dt: float
    observed: Float[np.ndarray, "K A 4"]
    """NaN where an agent was missing."""
    truth: Float[np.ndarray, "P A 4"]
    present: Bool[np.ndarray, "P A"]
    lead: float
    """Seconds from the last observation to the first agent's reaching the crossing point."""

    @property
    def history(self) -> int:
        """Observations of the agent that was seen less often."""
        return int((~np.isnan(self.observed[..., 0])).sum(axis=0).min())


class EncounterError(ValueError):
    """An encounter cannot be evaluated; the message says why."""


def encounters(
    path: str | Path,
    *,
    agents: Sequence[str] | None = None,
    count: int | None = 3,
    recording_number: str | None = None,
) -> tuple[Encounter, ...]:
    """The encounter of two given agents, or those of the `count` closest crossings, in order.

    Pairs that were not both seen long enough around their crossing, or not before it, are passed
    over, unless they were asked for by id. Raises `RecordingError` for a bad file and
    `EncounterError` for bad ids.
    """
    recording = open_recording(path, recording=recording_number)
    if agents is not None:
        if len(agents) != 2:
            raise EncounterError(f"ids: {len(agents)} given; an encounter has two agents")
        unknown = [a for a in agents if a not in recording.agents]
        if unknown:
            raise EncounterError(
                f"ids: {recording.name} has no agent {unknown[0]!r}; it has "
                f"{', '.join(recording.agents[:12])}{', ...' if len(recording.agents) > 12 else ''}"
            )
        try:
            interaction = find_interaction(recording, (agents[0], agents[1]))
        except ValueError as error:
            raise EncounterError(f"ids: {error}") from error
        return (cut(recording, interaction),)
    found = []
    for interaction in closest_crossings(recording):
        try:
            encounter = cut(recording, interaction)
        except EncounterError:
            continue
        if encounter.lead < LEAST_LEAD:
            continue
        found.append(encounter)
        if count is not None and len(found) == count:
            break
    if not found:
        raise EncounterError(
            f"{recording.name}: no two agents cross and are seen long enough before and after"
        )
    return tuple(found)


def cut(recording: Recording, interaction: Interaction) -> Encounter:
    """Observations up to `LEAD_SECONDS` before the crossing, and the steps after them."""
    rate = recording.rate
    every = max(1, round(STEP_SECONDS * rate / recording.frame_step)) * recording.frame_step
    dt = every / rate
    tracks = [recording.track(a) for a in interaction.agents]
    both = max(int(t.frames[0]) for t in tracks), min(int(t.frames[-1]) for t in tracks)
    last = round((interaction.times[0] - LEAD_SECONDS) * rate)
    # Late arrivals are observed for as long as there is.
    last = max(last, both[0] + (LEAST_OBSERVED - 1) * every)
    base = int(tracks[0].frames[0])
    last = base + math.ceil((last - base) / every) * every
    if last + 4 * every > both[1]:
        raise EncounterError(
            f"{interaction.agents[0]} and {interaction.agents[1]}: not both seen for "
            f"{3 * dt:.1f} s before and {4 * dt:.1f} s after the prediction starts"
        )
    first = last - (OBSERVED - 1) * every
    window = recording.window(interaction.agents, first, OBSERVED + PREDICTED, every)
    if window.present[:OBSERVED].sum(axis=0).min() < LEAST_OBSERVED:
        raise EncounterError(f"{interaction.agents}: too few observations before the crossing")
    return Encounter(
        recording.name,
        interaction,
        dt,
        window.states[:OBSERVED],
        window.states[OBSERVED:],
        window.present[OBSERVED:],
        float(interaction.times[0]) - last / rate,
    )


def constant_velocity(encounter: Encounter) -> Float[np.ndarray, "P A 2"]:
    """Each agent goes on from its last observed state at that state's velocity."""
    count = encounter.observed.shape[1]
    path = np.zeros((PREDICTED, count, 2))
    for a in range(count):
        seen = np.flatnonzero(~np.isnan(encounter.observed[:, a, 0]))
        state = encounter.observed[seen[-1], a]
        steps = np.arange(1, PREDICTED + 1) + (OBSERVED - 1 - seen[-1])
        path[:, a] = state[:2] + encounter.dt * steps[:, None] * state[2:4]
    return path


def forecast(encounter: Encounter, method: str, *, noise_std: float = NOISE_STD) -> Forecast:
    """One method's prediction; `noise_std` is the recording's measurement noise (m, m/s)."""
    if method not in METHODS:
        raise ValueError(f"method: is {method!r}; expected one of {', '.join(METHODS)}")
    agents = encounter.interaction.agents
    straight = constant_velocity(encounter)
    if method == "constant velocity":
        return _judged(encounter, method, straight, None, True)
    game = encounter_game(encounter.interaction.kinds, OBSERVED - 1 + PREDICTED, encounter.dt)
    model = full_state(game.state_sizes)
    seen = encounter.observed.reshape(OBSERVED, -1)
    initial = guess_initial_states(game, model, seen)
    velocities = []
    for a in range(len(agents)):
        rows = np.flatnonzero(~np.isnan(encounter.observed[:, a, 2]))
        velocities.append(encounter.observed[rows[-1], a, 2:4])
    infer = method == "foresight"
    found = estimate(
        game,
        seen,
        model,
        initial_state=initial,
        theta=[player_theta(v) for v in velocities],
        gamma=0.8 if infer else 1.0,
        free=Free(("velocity",), infer, True),
        covariance=aging_covariance(noise_std, seen.shape[1]),
        prior=PRIOR,
        starts=MultiStart(4),
    )
    if int(found.status) != Status.SOLVED:
        return _judged(encounter, method, straight, None, False)
    path = np.stack([s[OBSERVED:, :2] for s in found.solution.states], axis=1)
    return _judged(encounter, method, path, found, True)


def aging_covariance(noise_std: float, size: int) -> Float[np.ndarray, "K size size"]:
    """Covariance per observation, newest last."""
    deviation = noise_std * AGING ** np.arange(OBSERVED - 1, -1, -1)
    return deviation[:, None, None] ** 2 * np.eye(size)


def _judged(
    encounter: Encounter, method: str, path: Any, found: Estimate | None, solved: bool
) -> Forecast:
    average, final = displacement(path, encounter.truth[..., :2], encounter.present)
    agents = encounter.interaction.agents
    if found is None:
        return Forecast(method, agents, path, average, final, None, None, None, solved)
    flags = dict(zip(found.names, found.determined, strict=True))
    determined = np.array([flags.get(f"gamma of {a}", True) for a in range(len(agents))])
    return Forecast(
        method, agents, path, average, final, found.gamma, found.gamma_deviation, determined, solved
    )
