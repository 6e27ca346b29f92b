"""A table of two walkers that cross, from the encounter game with known discount factors."""

import csv
from pathlib import Path

import numpy as np

from foresight_env.equilibrium import solve
from foresight_env.scenarios.encounter import encounter_game, player_theta

RATE = 10.0
"""Hz."""
STARTS = ((-3.0, 0.0, 1.3, 0.0), (0.1, -3.2, 0.0, 1.35))
GAMMAS = {"ann": 0.9, "bob": 0.5}
"""Per 0.2 s."""
COLLISION_WEIGHT = 5.0
NOISE = 0.01


def walker_rows(seed: int = 0) -> list[tuple[float, str, float, float]]:
    """Return rows of time (s), person, x, y (m)."""
    game = encounter_game(("pedestrian", "pedestrian"), 60, 1.0 / RATE)
    theta = [
        {**player_theta("pedestrian", np.array(s[2:])), "collision_weight": COLLISION_WEIGHT}
        for s in STARTS
    ]
    gamma = np.sqrt(list(GAMMAS.values()))  # two steps of the game take 0.2 s
    played = solve(game, [np.array(s) for s in STARTS], theta, gamma, throw=True)
    random = np.random.default_rng(seed)
    rows = []
    for name, states in zip(GAMMAS, played.states, strict=True):
        places = states[:, :2] + NOISE * random.standard_normal((len(states), 2))
        rows += [(k / RATE, name, *map(float, place)) for k, place in enumerate(places)]
    return sorted(rows)


def write_walkers(path: Path, seed: int = 0) -> Path:
    """Write the rows as a CSV file with the header time,person,x,y."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", "person", "x", "y"])
        for time, name, x, y in walker_rows(seed):
            writer.writerow([f"{time:.1f}", name, f"{x:.4f}", f"{y:.4f}"])
    return path
