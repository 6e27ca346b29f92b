"""How egos and predictors are called and coloured in tables and figures.

Colours: Okabe and Ito (2008) for the few that stand in most figures, Tol's muted scheme (2021) for
all others; both are told apart by the colour-blind.
"""

from __future__ import annotations

from zlib import crc32

LABELS = {
    "foresight": "gamma inferred",
    "farsighted": "gamma = 1",
    "constant-velocity": "constant velocity",
    "constant-turn-rate": "constant turn rate",
    "constant-acceleration": "constant acceleration",
    "kalman": "Kalman filter",
    "social-force": "social force",
    "orca": "ORCA",
    "oracle": "oracle",
    "idm": "IDM",
    "kkt-residual": "KKT residual",
    "particle-filter": "particle filter",
    "social-lstm": "social LSTM",
    "cloned": "cloned oracle",
    "ppo": "PPO",
}
OTHERS = {"receding": "game agents", "idm": "IDM/MOBIL cars", "open_loop": "open-loop game agents"}
"""Whom an ego drives among."""
COLOURS = {
    "truth": "#000000",
    "foresight": "#0072B2",
    "farsighted": "#D55E00",
    "constant-velocity": "#009E73",
    "constant-turn-rate": "#56B4E9",
    "oracle": "#CC79A7",
    "idm": "#E69F00",
    "constant-acceleration": "#6699CC",
    "kalman": "#44AA99",
    "social-force": "#882255",
    "orca": "#999933",
    "kkt-residual": "#AA4499",
    "particle-filter": "#332288",
    "social-lstm": "#661100",
    "transformer": "#117733",
    "cloned": "#882255",
    "ppo": "#7F7F00",
}
OTHER_COLOURS = ("#DDCC77", "#CC6677", "#88CCEE", "#777777")


def label_of(name: str) -> str:
    """What a reader sees for a name of the registry; a user's own name stays as it is."""
    if name.endswith("+plan"):
        return f"{label_of(name.removesuffix('+plan'))}, planned"
    return LABELS.get(name, name)


def colour_of(name: str) -> str:
    """The same in every figure: of a name without one of its own, chosen by its letters."""
    name = name.replace(" ", "-")
    return COLOURS.get(name, OTHER_COLOURS[crc32(name.encode()) % len(OTHER_COLOURS)])
