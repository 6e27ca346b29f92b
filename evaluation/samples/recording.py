"""A small recording in the DUT format that the project makes itself, for want of a real one.

One encounter of two pedestrians and two of a car and a pedestrian: equilibria of the encounter
game with known discount factors, plus measurement noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from foresight_env.datasets import Recording, Track, write_dut
from foresight_env.equilibrium import solve
from foresight_env.games.kinds import is_vehicle
from foresight_env.scenarios.encounter import encounter_game, player_theta

RATE = 23.98
"""Frames per second, as in DUT."""
SECONDS = 9.5
PEOPLE_STATES = ((-6.0, 0.0, 1.3, 0.0), (0.2, -6.3, 0.0, 1.35))
"""`[px, py, vx, vy]` (m, m/s) of two people, who would keep their velocities."""
PEOPLE_GAMMAS = (0.9, 0.5)
DRIVEN = (
    (((0.0, -40.0, 4.5, 0.0), (14.0, -44.5, 0.0, 1.3)), (0.6, 0.9)),
    (((0.0, 40.0, 4.0, 0.0), (13.0, 44.5, 0.0, -1.3)), (0.7, 0.95)),
)
"""`[px, py, v, psi]` (m, m/s, rad) of a car, which would keep its speed, and a person's
`[px, py, vx, vy]`, with their discount factors: the person waits, the car turns aside late."""
COLLISION_WEIGHT = 2.0
"""Of all; larger than that of recorded people, so that short encounters identify gammas."""
ENCOUNTERS = (
    (("pedestrian", "pedestrian"), PEOPLE_STATES, PEOPLE_GAMMAS),
    *((("car", "pedestrian"), *encounter) for encounter in DRIVEN),
)


def made_recording(seed: int = 0, noise_std: float = 0.01) -> Recording:
    """Three encounters of two agents each, tracks at the DUT rate."""
    random = np.random.default_rng(seed)
    every = 5
    dt = every / RATE
    steps = int(SECONDS / dt)
    tracks: list[Track] = []
    names = iter(true_gammas())
    for kinds, starts, gamma in ENCOUNTERS:
        game = encounter_game(kinds, steps, dt)
        first = [np.array(state) for state in starts]
        theta = [
            {
                **player_theta(kind, (state[2], 0.0) if is_vehicle(kind) else state[2:]),
                "collision_weight": COLLISION_WEIGHT,
            }
            for kind, state in zip(kinds, first, strict=True)
        ]
        solution = solve(game, first, theta, np.array(gamma), throw=True)
        for kind, states in zip(kinds, solution.states, strict=True):
            coarse = np.arange(len(states)) * every
            frames = np.arange(coarse[-1] + 1)
            fine = np.stack([np.interp(frames, coarse, s) for s in states.T], axis=1)
            fine += noise_std * random.standard_normal(fine.shape)
            tracks.append(_track(next(names), kind, frames, fine))
    return Recording("made_by_foresight_env", "dut", RATE, tuple(tracks))


def _track(
    name: str, kind: str, frames: Int[np.ndarray, "F"], states: Float[np.ndarray, "F 4"]
) -> Track:
    if not is_vehicle(kind):
        unknown = np.full(len(frames), np.nan)
        return Track(name, kind, frames, states[:, :2], states[:, 2:], unknown)
    heading = states[:, 3]
    velocity = states[:, 2:3] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return Track(name, kind, frames, states[:, :2], velocity, np.mod(heading, 2.0 * np.pi))


def true_gammas() -> dict[str, float]:
    """The recording's discount factors by agent, in the order of the encounters."""
    found: dict[str, float] = {}
    for kinds, _, gammas in ENCOUNTERS:
        for kind, gamma in zip(kinds, gammas, strict=True):
            label = "veh" if is_vehicle(kind) else "ped"
            number = sum(name.startswith(label) for name in found)
            found[f"{label}:{number}"] = gamma
    return found


def driven_pairs() -> tuple[tuple[str, str], ...]:
    """Each car with the person whom it meets."""
    names = iter(true_gammas())
    pairs = [(kinds, (next(names), next(names))) for kinds, _, _ in ENCOUNTERS]
    return tuple(pair for kinds, pair in pairs if is_vehicle(kinds[0]))


def write_sample(folder: Path) -> Path:
    """Write the recording as a DUT file and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = write_dut(made_recording(), folder / "made_by_foresight_env", overwrite=True)
    return paths[0]
