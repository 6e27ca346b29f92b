"""Whole recorded encounters: discount factors from all positions before, during and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.windows.encounters import EncounterError, of_crossings
from foresight_env.datasets import Interaction, Recording, Window
from foresight_env.equilibrium import Status
from foresight_env.games import positions
from foresight_env.games.kinds import is_vehicle
from foresight_env.inverse import (
    Estimate,
    Free,
    MultiStart,
    Profile,
    estimate,
    guess_initial_state,
)
from foresight_env.scenarios.encounter import COLLISION_WEIGHT, encounter_game, player_theta

STEP_SECONDS = 0.2
"""Target time between steps, at least one row of the recording."""
BEFORE_SECONDS = 3.0
"""The window begins this long before the first agent reaches the crossing point."""
WINDOW_SECONDS = 6.0
LEAST_STEPS = 12
"""Positions of each agent in the window."""
ASSUMED_NOISE = 0.03
"""Standard deviation (m) of the first fit; the second has that of the first fit's residuals."""
LEAST_NOISE = 1e-3
"""m; residuals below it are rounding."""


@dataclass(frozen=True, eq=False)
class WholeEncounter:
    """The encounter game fitted to all observed positions of two agents."""

    recording: str
    agents: tuple[str, str]
    dt: float
    observed: Float[np.ndarray, "K 2 2"]
    """m; NaN where there is no row."""
    noise_std: float
    """m, of the residuals."""
    estimate: Estimate

    @property
    def fitted(self) -> Float[np.ndarray, "K 2 2"]:
        """Positions of the fitted equilibrium, m."""
        return np.stack([states[:, :2] for states in self.estimate.solution.states], axis=1)


def fit_whole_encounters(
    recording: Recording,
    *,
    agents: Sequence[str] | None = None,
    count: int | None = 3,
    collision_weight: float = COLLISION_WEIGHT,
) -> tuple[WholeEncounter, ...]:
    """Fit the encounter of two given agents, or those of the `count` closest crossings.

    Args:
        recording: with the agents.
        agents: two ids; None finds pairs whose paths cross, and leaves out those that are too
            short to be fitted.
        count: how many; None for all.
        collision_weight: as `fit_whole_encounter`.

    Returns:
        At least one fit.

    Raises:
        EncounterError: bad ids, or there is no encounter that can be fitted.
        ValueError: `collision_weight` is not positive and finite.
    """
    check_positive("collision_weight", collision_weight)
    return of_crossings(
        recording, agents, count,
        lambda crossing: fit_whole_encounter(recording, crossing, collision_weight), "fitted",
    )  # fmt: skip


def check_positive(name: str, number: float) -> None:
    """Raise `ValueError` unless the number is positive and finite."""
    if not (math.isfinite(number) and number > 0.0):
        raise ValueError(f"{name}: is {number}; expected a positive number")


def fit_whole_encounter(
    recording: Recording,
    interaction: Interaction,
    collision_weight: float = COLLISION_WEIGHT,
    noise_std: float | None = None,
) -> WholeEncounter:
    """Fit preferred motions, discount factors and initial states to a whole encounter.

    Args:
        recording: with both agents.
        interaction: their crossing.
        collision_weight: of the encounter game, known: discount factors are inferred given it.
        noise_std: of the positions, m; None estimates it from the residuals of a first fit.

    Returns:
        The fit; its intervals of discount factors are 90 % by profile likelihood.

    Raises:
        EncounterError: an agent has fewer than `LEAST_STEPS` positions in the window, or no fit
            succeeds.
    """
    dt, window = encounter_window(recording, interaction)
    observed = np.array(window.states[..., :2])
    found, noise_std = fit_positions(window.kinds, dt, observed, collision_weight, noise_std)
    if int(found.status) != Status.SOLVED:
        raise EncounterError(f"{' and '.join(interaction.agents)}: no fit of the game succeeds")
    return WholeEncounter(recording.name, interaction.agents, dt, observed, noise_std, found)


def encounter_window(recording: Recording, interaction: Interaction) -> tuple[float, Window]:
    """Cut out `WINDOW_SECONDS` around the crossing of two agents, steps near `STEP_SECONDS`.

    Args:
        recording: with both agents.
        interaction: their crossing.

    Returns:
        Seconds per step, and the window, which begins `BEFORE_SECONDS` before the first agent
        reaches the crossing point, or where both are there.

    Raises:
        EncounterError: an agent has fewer than `LEAST_STEPS` positions in it.
    """
    rows = max(1, round(STEP_SECONDS * recording.rate / recording.frame_step))
    every = rows * recording.frame_step
    dt = every / recording.rate
    tracks = [recording.track(agent) for agent in interaction.agents]
    start = max(int(track.frames[0]) for track in tracks)
    crossing = round(interaction.times[0] * recording.rate)
    steps_before = max(0, crossing - start) // every
    first = crossing - min(steps_before, round(BEFORE_SECONDS / dt)) * every
    first -= (first - int(tracks[0].frames[0])) % every  # on the rows of the recording
    window = recording.window(interaction.agents, first, round(WINDOW_SECONDS / dt) + 1, every)
    least = int(window.present.sum(axis=0).min())
    if least < LEAST_STEPS:
        raise EncounterError(
            f"{' and '.join(interaction.agents)}: {least} positions {dt:.2g} s apart around the "
            f"crossing; expected at least {LEAST_STEPS} of each agent"
        )
    return dt, window


def fit_positions(
    kinds: tuple[str, ...],
    dt: float,
    observed: Float[np.ndarray, "K 2 2"],
    collision_weight: float,
    noise_std: float | None = None,
    infer_gamma: bool = True,
) -> tuple[Estimate, float]:
    """Fit the encounter game to positions.

    Args:
        kinds: of the agents.
        dt: seconds per step.
        observed: m; NaN where there is none.
        collision_weight: of the game, known.
        noise_std: of the positions, m; None estimates it from the residuals of a first fit.
        infer_gamma: False takes all discount factors for 1.

    Returns:
        The estimate, with 90 % intervals by profile likelihood where discount factors are
        inferred, and the noise's standard deviation (m).
    """
    found = _fit(kinds, dt, observed, collision_weight, noise_std or ASSUMED_NOISE, infer_gamma)
    if noise_std is None:
        residuals = np.stack([s[:, :2] for s in found.solution.states], axis=1) - observed
        free = residuals[~np.isnan(residuals)].size - len(found.parameters)
        noise_std = max(LEAST_NOISE, float(np.sqrt(np.nansum(residuals**2) / max(1, free))))
        found = _fit(kinds, dt, observed, collision_weight, noise_std, infer_gamma)
    return found, noise_std


def _fit(
    kinds: tuple[str, ...],
    dt: float,
    observed: Float[np.ndarray, "K 2 2"],
    collision_weight: float,
    noise_std: float,
    infer_gamma: bool,
) -> Estimate:
    game = encounter_game(kinds, len(observed) - 1, dt)
    model = positions(game.state_sizes)
    seen = observed.reshape(len(observed), -1)
    first = guess_initial_state(game, model, seen)
    theta = [
        {
            **player_theta(kind, (state[2], 0.0) if is_vehicle(kind) else state[2:4]),
            "collision_weight": collision_weight,
        }
        for kind, state in zip(kinds, first, strict=True)
    ]
    return estimate(
        game,
        seen,
        model,
        initial_state=first,
        theta=theta,
        gamma=0.8 if infer_gamma else 1.0,
        free=[
            Free(("speed", "curvature") if is_vehicle(kind) else ("velocity",), infer_gamma, True)
            for kind in kinds
        ],
        covariance=noise_std**2,
        starts=MultiStart(4),
        profile=Profile() if infer_gamma else None,
    )
