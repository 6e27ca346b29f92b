"""How the time of one Newton iteration grows with the horizon and with the number of players."""

from __future__ import annotations

from functools import partial

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import ROOT, Yardstick, median_seconds
from foresight_env.equilibrium import Status, solve
from foresight_env.scenarios.crosswalk import crosswalk_game, player_theta

PICTURE = ROOT / "docs" / "images" / "growth.png"
HORIZONS = (10, 25, 50, 100, 200)
PLAYERS = (2, 3, 4, 6, 8)


def measure(players: int, horizon: int) -> tuple[float, int, bool]:
    """Seconds per Newton iteration, iterations, solved: walkers that cross on a circle."""
    angle = 0.3 + 2.0 * np.pi * np.arange(players) / players
    start = max(1.5, 0.25 * players) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    states = np.concatenate([start, np.zeros((players, 2))], axis=1)
    theta = [player_theta(-s) for s in start]
    call = partial(solve, crosswalk_game(players, horizon), states, theta, 0.8)
    found = call()
    iterations = int(found.iterations)
    return median_seconds(call, 7) / iterations, iterations, int(found.status) == Status.SOLVED


def slope(sizes: tuple[int, ...], seconds: list[float]) -> float:
    """Exponent of growth over the larger half of the sizes."""
    half = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0])


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` leaves out the largest of each."""
    horizons = HORIZONS[:-1] if arguments.quick else HORIZONS
    players = PLAYERS[:-1] if arguments.quick else PLAYERS
    yardstick = Yardstick.measure()
    rows: list[TableRow] = []
    lines: dict[str, tuple[tuple[int, ...], list[float]]] = {}
    for title, sizes, pairs in (
        ("horizon T (2 players)", horizons, [(2, t) for t in horizons]),
        ("players N (T = 10)", players, [(n, 10) for n in players]),
    ):
        seconds = []
        for n, t in pairs:
            each, iterations, solved = measure(n, t)
            seconds.append(each)
            rows.append(
                {
                    "N": str(n),
                    "T": str(t),
                    "one iteration": yardstick.formatted(each),
                    "iterations": iterations,
                    "solved": "yes" if solved else "no",
                }
            )
        lines[title] = (sizes, seconds)
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), constrained_layout=True)
    exponents = []
    for axis, (title, (sizes, seconds)) in zip(axes, lines.items(), strict=True):
        exponent = slope(sizes, seconds)
        exponents.append(f"{exponent:.2f} in {title.split(' ')[0]}")
        axis.loglog(sizes, 1e6 * np.array(seconds), "o-", label="measured")
        power = 1.0 if title.startswith("horizon") else 3.0
        guide = 1e6 * seconds[-1] * (np.array(sizes) / sizes[-1]) ** power
        axis.loglog(sizes, guide, "--", color="0.6", label="linear" if power == 1 else "cubic")
        axis.set(xlabel=title, ylabel="one Newton iteration [us]")
        axis.set_xticks(sizes, [str(s) for s in sizes])
        axis.minorticks_off()
        axis.legend()
    if not arguments.quick:
        figure.savefig(PICTURE, dpi=120)
    plt.close(figure)
    note = (
        "Walkers that cross on a circle, soft proximity, one solve at a time. Exponents over the "
        f"larger half: {', '.join(exponents)}. ![growth](../images/growth.png) {yardstick.note}"
    )
    return [Result("Growth", note, rows).show(arguments.console)]
