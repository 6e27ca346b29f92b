"""A recording of the published junction in inD's format that the project makes itself.

inD cannot be shipped. Here the agents of `scenarios.junction` play their open-loop equilibrium with
hidden discount factors, under the published track numbers, frames and turn of the map.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from foresight_env.datasets import Recording, Track, write_ind
from foresight_env.equilibrium import Status, solve
from foresight_env.games.kinds import is_vehicle, kind_of
from foresight_env.scenarios.aachen import AACHEN_ROTATION
from foresight_env.scenarios.intersection import DT, HORIZON
from foresight_env.scenarios.junction import (
    draw_junction,
    junction_game,
    junction_kinds,
)

NUMBER, LOCATION, RATE = 7, 1, 25.0
TRACKS = ("201", "205", "207", "208")
FRAMES = (26158, 26320)
EVERY = 6
GAMMAS = (0.6, 0.9, 0.7, 0.95)
"""Discount factors of the tracks, the truth that may be found again."""


def made_junction(seed: int = 0, noise_std: float = 0.01) -> Recording:
    """Two people and two cars over 28 steps, at 25 Hz, with measurement noise (m, m/s, rad)."""
    random = np.random.default_rng(seed)
    game = junction_game(2, 2, HORIZON)
    for last in (False, False, False, False, True):
        drawn = draw_junction(random, 2, 2)
        # One or two draws of twelve are not solved; which ones is up to rounding.
        solution = solve(game, drawn.initial_state, drawn.theta, np.array(GAMMAS), throw=last)
        if int(solution.status) == Status.SOLVED:
            break
    every = round(DT * RATE)
    tracks = []
    for name, kind, states in zip(TRACKS, junction_kinds(2, 2), solution.states, strict=True):
        coarse = np.arange(len(states)) * every
        frames = np.arange(coarse[-1] + 1)
        fine = np.stack([np.interp(frames, coarse, column) for column in states.T], axis=1)
        fine += noise_std * random.standard_normal(fine.shape)
        walks = not is_vehicle(kind)
        if walks:
            velocity = fine[:, 2:]
            heading = np.arctan2(velocity[:, 1], velocity[:, 0])
        else:
            heading = fine[:, 3]
            velocity = fine[:, 2:3] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        size = kind_of(kind).length, kind_of(kind).width
        own = np.mod(heading, 2.0 * math.pi)
        tracks.append(Track(name, kind, FRAMES[0] + frames, fine[:, :2], velocity, own, *size))
    return Recording(f"{NUMBER:02d}", "ind", RATE, tuple(tracks)).rotate(-AACHEN_ROTATION)


def write_junction_sample(folder: Path) -> Path:
    """Write it as inD's three files and return their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_ind(made_junction(), folder, NUMBER, location=LOCATION, overwrite=True)
    return folder
