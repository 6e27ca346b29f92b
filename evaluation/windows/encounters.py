"""Recorded encounters of two agents: infer on the first part, predict the rest, compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from agents.interfaces.predictor import Forecast
from agents.registry import make_predictor
from evaluation.metrics.trajectory import displacement
from evaluation.windows.interaction import LEAST_OBSERVED, Grid, PredictionWindow, cut
from foresight_env.datasets import (
    Interaction,
    Recording,
    closest_crossings,
    find_interaction,
)

Made = TypeVar("Made")
LEAD_SECONDS = 2.0
"""The prediction starts this long before the first agent reaches the crossing point, or as soon as
both have been seen `LEAST_OBSERVED` times, whichever is later."""
LEAST_LEAD_STEPS = 1
"""Of pairs that the project picks itself: those that were seen together too late are no
predictions of the encounter."""
LEAST_COMPARED = 4
"""Steps after the prediction starts in which both are still there."""
PREDICTORS = ("encounter-game", "encounter-game-gamma-1", "constant-velocity")


@dataclass(frozen=True, eq=False)
class Encounter:
    """Two agents whose paths cross, and the window that is cut out before they do."""

    interaction: Interaction
    window: PredictionWindow
    lead: float
    """Seconds from the last observation to the first agent's reaching the crossing point."""


@dataclass(frozen=True, eq=False)
class Judged:
    """One predictor's forecast of one encounter, with its errors (m)."""

    predictor: str
    forecast: Forecast
    average_error: float
    final_error: float


class EncounterError(ValueError):
    """An encounter cannot be evaluated; the message says why."""


def encounters(
    recording: Recording, *, agents: Sequence[str] | None = None, count: int | None = 3
) -> tuple[Encounter, ...]:
    """Return the encounter of two given agents, or those of the `count` closest crossings.

    Pairs that were not both seen long enough around their crossing, or not before it, are passed
    over, unless they were asked for by id.

    Args:
        recording: with the agents.
        agents: two ids; None finds pairs whose paths cross.
        count: how many; None for all.

    Returns:
        The encounters, in the order of the closest crossings.

    Raises:
        EncounterError: bad ids, or there is no encounter.
    """
    if agents is not None:
        interaction = crossing_of(recording, agents)
        return (before_crossing(recording, interaction),)
    found = []
    for interaction in closest_crossings(recording):
        try:
            encounter = before_crossing(recording, interaction)
        except EncounterError:
            continue
        if encounter.lead < LEAST_LEAD_STEPS * encounter.window.history.dt:
            continue
        found.append(encounter)
        if count is not None and len(found) == count:
            break
    if not found:
        raise EncounterError(
            f"{recording.name}: no two agents cross and are seen long enough before and after"
        )
    return tuple(found)


def crossing_of(recording: Recording, agents: Sequence[str]) -> Interaction:
    """Return the crossing of two agents.

    Args:
        recording: with the agents.
        agents: two different ids.

    Returns:
        Their crossing.

    Raises:
        EncounterError: there are not two ids, one is unknown, or the agents' paths do not cross.
    """
    if len(agents) != 2:
        raise EncounterError(f"ids: {len(agents)} given; an encounter has two agents")
    unknown = [a for a in agents if a not in recording.agents]
    if unknown:
        raise EncounterError(
            f"ids: {recording.name} has no agent {unknown[0]!r}; it has "
            f"{', '.join(recording.agents[:12])}{', ...' if len(recording.agents) > 12 else ''}"
        )
    try:
        return find_interaction(recording, (agents[0], agents[1]))
    except ValueError as error:
        raise EncounterError(f"ids: {error}") from error


def of_crossings(
    recording: Recording,
    agents: Sequence[str] | None,
    count: int | None,
    make: Callable[[Interaction], Made],
    done: str,
) -> tuple[Made, ...]:
    """Make something of the crossing of two given agents, or of the `count` closest crossings.

    Args:
        recording: with the agents.
        agents: two ids; None takes the closest crossings and passes over those of which `make`
            raises `EncounterError`.
        count: how many; None for all.
        make: of one crossing.
        done: past participle for the message, such as "fitted".

    Returns:
        At least one.

    Raises:
        EncounterError: bad ids, or there is no crossing of which it can be made.
    """
    if agents is not None:
        return (make(crossing_of(recording, agents)),)
    found: list[Made] = []
    reason = "the paths of no two agents cross"
    for interaction in closest_crossings(recording):
        try:
            found.append(make(interaction))
        except EncounterError as error:
            reason = str(error)
        if len(found) == count:
            break
    if not found:
        raise EncounterError(f"{recording.name}: no encounter can be {done}: {reason}")
    return tuple(found)


def before_crossing(recording: Recording, interaction: Interaction) -> Encounter:
    """Observations up to `LEAD_SECONDS` before the crossing, and the steps after them."""
    rate, grid = recording.rate, Grid.of(recording)
    tracks = [recording.track(a) for a in interaction.agents]
    both = max(int(t.frames[0]) for t in tracks), min(int(t.frames[-1]) for t in tracks)
    last = round((interaction.times[0] - LEAD_SECONDS) * rate)
    # Late arrivals are observed for as long as there is.
    last = max(last, both[0] + (LEAST_OBSERVED - 1) * grid.every)
    base = int(tracks[0].frames[0])
    last = base + math.ceil((last - base) / grid.every) * grid.every
    if last + LEAST_COMPARED * grid.every > both[1]:
        raise EncounterError(
            f"{interaction.agents[0]} and {interaction.agents[1]}: not both seen for "
            f"{(LEAST_OBSERVED - 1) * grid.dt:.1f} s before and {LEAST_COMPARED * grid.dt:.1f} s "
            "after the prediction starts"
        )
    try:
        window = cut(recording, interaction.agents, last)
    except ValueError as error:
        raise EncounterError(f"{interaction.agents}: {error}") from error
    if window.seen_steps < LEAST_OBSERVED:
        raise EncounterError(f"{interaction.agents}: too few observations before the crossing")
    return Encounter(interaction, window, float(interaction.times[0]) - last / rate)


def forecast(encounter: Encounter, predictor: str) -> Judged:
    """A registered predictor's forecast and its errors."""
    window = encounter.window
    found = make_predictor(predictor).predict(window.history, len(window.truth))
    return Judged(predictor, found, *displacement(found.most_likely, window.truth, window.present))
