"""How egos and predictors are called and coloured in tables and figures.

Colours: Okabe and Ito (2008) for the few that stand in most figures, Tol's muted scheme (2021) for
all others; both can be distinguished by the colour-blind.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import lru_cache
from typing import Any
from zlib import crc32

from agents.registry import PLANNED, make_ego, make_predictor

OTHERS = {"receding": "game agents", "idm": "IDM/MOBIL cars", "open_loop": "open-loop game agents"}
"""Name of the others that an ego drives among."""
COLOURS = {
    "truth": "#000000",
    "infer-gamma": "#0072B2",
    "assume-gamma-1": "#D55E00",
    "junction-game": "#0072B2",
    "junction-game-gamma-1": "#D55E00",
    "hybrid-game": "#EE3377",
    "hybrid-game-gamma-1": "#CC3311",
    "hybrid-network": "#009988",
    "scene-game": "#0077BB",
    "scene-game-gamma-1": "#EE7733",
    "encounter-game": "#CC6677",
    "encounter-game-gamma-1": "#DDCC77",
    "constant-velocity": "#009E73",
    "constant-velocity-sampled": "#88CCEE",
    "constant-turn-rate": "#56B4E9",
    "oracle": "#CC79A7",
    "know-gamma": "#56B4E9",
    "clairvoyant": "#000000",
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
NARROW, HEADING = 100, 14
"""Up to which width of a terminal the heads of columns are broken, into lines of how many
characters."""
OTHER_COLOURS = ("#88CCEE", "#777777", "#BBBBBB")


@lru_cache(maxsize=256)
def label_of(name: str) -> str:
    """Return what tables and figures show for a name: the name; of a user's object, its own `name`.

    A user's module that cannot be imported (any more) leaves the name as it was given.
    """
    if ":" not in name:
        return name
    try:
        return str((make_ego if name.endswith(PLANNED) else _either)(name).name)
    except ValueError:
        return name


def heading_of(name: str, width: int) -> str:
    """Return a label for the head of a column, broken into lines where tables are narrow.

    Args:
        name: Of an ego, predictor or method.
        width: Of the table's terminal or file, characters.
    """
    if width > NARROW:
        return label_of(name)
    return "\n".join(textwrap.wrap(label_of(name), HEADING, break_long_words=False))


def _either(name: str) -> Any:
    """A user's predictor or ego."""
    try:
        return make_predictor(name)
    except ValueError:
        return make_ego(name)


def colour_of(name: str) -> str:
    """The same in every figure: of a name without a fixed one, chosen by its letters."""
    return COLOURS.get(name, OTHER_COLOURS[crc32(name.encode()) % len(OTHER_COLOURS)])


def file_name(recording: str, agents: Sequence[str], suffix: str = "") -> str:
    """Return a file's name, without ending, for agents of a recording."""
    names = (agent.replace(":", "") for agent in agents)
    return "_".join([recording, *names, *([suffix] if suffix else [])])
