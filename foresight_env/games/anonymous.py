"""Costs and constraints that know players by their role, not by their number.

Players that are alike are evaluated side by side, as one of them (`equilibrium.peers`): a game of
four equal cars then has the operations of one car. That changes nothing where a cost asks only what
the player itself and the others, in their order, do.
"""

from __future__ import annotations


class Anonymous:
    """Base of costs and constraints that treat all players alike; the default is not to."""

    def tells_apart(self, i: int, j: int) -> bool:
        """Whether it is another function for player i than for player j.

        Both see themselves and, in their order, everybody else.
        """
        return False


def tells_apart(part: object, i: int, j: int) -> bool:
    """The same of any cost, constraint or function: those that do not say are taken to."""
    ask = getattr(part, "tells_apart", None)
    return True if ask is None else bool(ask(i, j))
