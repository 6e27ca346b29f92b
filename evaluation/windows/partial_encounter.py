"""Recorded encounters of which the first seconds are observed and the rest is predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agents.interfaces.predictor import History
from agents.registry import make_predictor
from evaluation.metrics.trajectory import displacement
from evaluation.windows.encounters import EncounterError, of_crossings
from evaluation.windows.whole_encounter import check_positive, encounter_window, fit_positions
from foresight_env.datasets import Interaction, Recording, observed_window
from foresight_env.equilibrium import Status
from foresight_env.inverse import Estimate
from foresight_env.scenarios.encounter import COLLISION_WEIGHT

LEAST_FITTED = 6
"""Positions of each agent that a fit needs: each has a velocity, a start and a discount factor."""
LEAST_COMPARED = 4
"""Positions of each agent after them, to compare with."""
METHODS = ("infer-gamma", "assume-gamma-1", "constant-velocity")
"""Games fitted to what was observed, and a predictor; in the order of tables."""


@dataclass(frozen=True, eq=False)
class PartialEncounter:
    """Predictions of the rest of an encounter, and the fit that they rest on."""

    recording: str
    agents: tuple[str, str]
    dt: float
    """Seconds per step."""
    positions: Float[np.ndarray, "K 2 2"]
    """m, recorded; NaN where there is no row."""
    num_observed: int
    """Steps that were observed; the rest is predicted."""
    estimate: Estimate
    """Of `infer-gamma`, from the observed steps."""
    predicted: dict[str, Float[np.ndarray, "P 2 2"]]
    """Positions (m) of the steps after the observed ones, by method."""

    @property
    def average_errors(self) -> dict[str, float]:
        """Mean displacement (ADE, m) by method."""
        truth = self.positions[self.num_observed :]
        present = ~np.isnan(truth[..., 0])
        return {name: displacement(p, truth, present)[0] for name, p in self.predicted.items()}


def predict_encounters(
    recording: Recording,
    observed_seconds: float,
    *,
    agents: Sequence[str] | None = None,
    count: int | None = 3,
    collision_weight: float = COLLISION_WEIGHT,
) -> tuple[PartialEncounter, ...]:
    """Predict the encounter of two given agents, or those of the `count` closest crossings.

    Args:
        recording: with the agents.
        observed_seconds: as `predict_encounter`.
        agents: two ids; None finds pairs whose paths cross, and leaves out those that are too
            short.
        count: how many; None for all.
        collision_weight: as `predict_encounter`.

    Returns:
        At least one prediction.

    Raises:
        EncounterError: bad ids, or there is no encounter that can be predicted.
        ValueError: a number is not positive and finite.
    """
    check_positive("collision_weight", collision_weight)
    check_positive("observed_seconds", observed_seconds)

    def predicted(crossing: Interaction) -> PartialEncounter:
        return predict_encounter(recording, crossing, observed_seconds, collision_weight)

    return of_crossings(recording, agents, count, predicted, "predicted")


def predict_encounter(
    recording: Recording,
    interaction: Interaction,
    observed_seconds: float,
    collision_weight: float = COLLISION_WEIGHT,
) -> PartialEncounter:
    """Infer from the first seconds of an encounter and predict the rest.

    The game's predictions are the equilibria fitted to the observed positions, with inferred
    discount factors and with discount factors of 1; constant velocity continues the last observed
    velocity.

    Args:
        recording: with both agents.
        interaction: their crossing.
        observed_seconds: from the start of the encounter, which is 3 s before the first agent
            reaches the crossing point, or where both are there (`encounter_window`).
        collision_weight: of the encounter game, known: discount factors are inferred given it.

    Returns:
        The predictions.

    Raises:
        EncounterError: an agent has too few positions before or after, or a fit fails.
    """
    dt, window = encounter_window(recording, interaction)
    count = 1 + round(observed_seconds / dt)
    names = " and ".join(interaction.agents)
    before, after = (int(p.sum(axis=0).min()) for p in np.split(window.present, [count]))
    if before < LEAST_FITTED or after < LEAST_COMPARED:
        raise EncounterError(
            f"{names}: {before} positions {dt:.2g} s apart in the first {observed_seconds:g} s and "
            f"{after} later; expected at least {LEAST_FITTED} and {LEAST_COMPARED} of each agent"
        )
    positions = np.array(window.states[..., :2])
    observed = np.where(np.arange(len(positions))[:, None, None] < count, positions, np.nan)
    fits = {
        method: fit_positions(
            window.kinds, dt, observed, collision_weight, infer_gamma=method == METHODS[0]
        )[0]
        for method in METHODS[:2]
    }
    for method, fit in fits.items():
        if int(fit.status) != Status.SOLVED:
            raise EncounterError(f"{names}: no fit of {method} succeeds")
    every = int(window.frames[1] - window.frames[0])
    past = observed_window(recording, interaction.agents, int(window.frames[0]), count, every)
    history = History(past.states, past.headings, past.kinds, past.extents, dt)
    straight = make_predictor(METHODS[2]).predict(history, len(positions) - count)
    predicted = {
        method: np.stack([s[count:, :2] for s in fit.solution.states], axis=1)
        for method, fit in fits.items()
    }
    return PartialEncounter(
        recording.name,
        interaction.agents,
        dt,
        positions,
        count,
        fits[METHODS[0]],
        {**predicted, METHODS[2]: straight.most_likely},
    )
