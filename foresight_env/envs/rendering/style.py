"""Style of all pictures: the agents' colours and the width of intervals."""

from __future__ import annotations

Colour = tuple[int, int, int]

COLOURS: tuple[Colour, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
    (240, 228, 66),
    (60, 60, 60),
)
"""Of the agents, in the order of their indices (Okabe and Ito, 2008; their black as dark grey)."""
INTERVAL_DEVIATIONS = 1.645
"""Half of a 90 % interval in standard deviations of a normal distribution."""
