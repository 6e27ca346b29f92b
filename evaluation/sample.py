"""A small recording in the DUT format that the project makes itself, for want of a real one.

People cross each other's way; the recording holds what the encounter game with hidden discount
factors lets them do, plus measurement noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foresight_env.datasets import Recording, Track, write_dut
from foresight_env.equilibrium import solve
from foresight_env.scenarios.encounter import encounter_game, player_theta

RATE = 23.98
"""Frames per second, as in DUT."""
SECONDS = 9.5
PAIRS = (
    # Start positions (m), wanted velocities (m/s) and discount factors of two people.
    (((-6.0, 0.0), (0.2, -6.3)), ((1.3, 0.0), (0.0, 1.35)), (0.9, 0.5)),
    (((-6.0, 14.0), (0.0, 20.3)), ((1.25, 0.0), (0.1, -1.3)), (0.5, 0.95)),
)


def made_recording(seed: int = 0, noise_std: float = 0.01) -> Recording:
    """Two encounters of two people each, filtered tracks at the DUT rate."""
    random = np.random.default_rng(seed)
    every = 5
    dt = every / RATE
    steps = int(SECONDS / dt)
    tracks = []
    for number, (starts, velocities, gamma) in enumerate(PAIRS):
        game = encounter_game(("pedestrian", "pedestrian"), steps, dt)
        first = [np.array([*p, *v]) for p, v in zip(starts, velocities, strict=True)]
        theta = [player_theta(np.array(v)) for v in velocities]
        solution = solve(game, first, theta, np.array(gamma), throw=True)
        for i, states in enumerate(solution.states):
            coarse = np.arange(len(states)) * every
            frames = np.arange(coarse[-1] + 1)
            fine = np.stack([np.interp(frames, coarse, s) for s in states.T], axis=1)
            fine += noise_std * random.standard_normal(fine.shape)
            tracks.append(
                Track(
                    f"ped:{2 * number + i}",
                    "pedestrian",
                    frames,
                    fine[:, :2],
                    fine[:, 2:],
                    np.full(len(frames), np.nan),
                )
            )
    return Recording("made_by_foresight_env", "dut", RATE, tuple(tracks))


def true_gammas() -> str:
    """The recording's discount factors, agent by agent, for a reader."""
    values = [gamma for _, _, pair in PAIRS for gamma in pair]
    return ", ".join(f"ped:{number} {value:g}" for number, value in enumerate(values))


def write_sample(folder: Path) -> Path:
    """Write the recording as a DUT file and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = write_dut(made_recording(), folder / "made_by_foresight_env", overwrite=True)
    return paths[0]
