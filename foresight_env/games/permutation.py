"""Costs and constraints that know players by their role, not by their number.

Those of identical players are vmapped (`equilibrium.conditions.identical_players`): four equal cars
take the operations of one. That changes nothing where a cost depends only on the player itself and
the others, in their order. Costs that differ in numbers alone are one function of these numbers
(`Parametric`).
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable


class PermutationInvariant:
    """Base of costs and constraints that treat all players identically; the default is not to.

    It is a promise about the class that names this base. A class derived from that one which
    computes something else, and neither names this base nor overrides `distinguishes`, is taken to
    distinguish players.
    """

    def __init_subclass__(cls, **arguments: object) -> None:
        super().__init_subclass__(**arguments)
        own = vars(cls)
        computes = "__call__" in own or "residual" in own or "loss" in own
        if computes and PermutationInvariant not in cls.__bases__ and "distinguishes" not in own:
            cls.distinguishes = _always  # type: ignore[method-assign]

    def distinguishes(self, i: int, j: int) -> bool:
        """Whether it is another function for player i than for player j.

        Both see themselves and, in their order, all others.
        """
        return False


@runtime_checkable
class Parametric(Protocol):
    """A cost with numbers, such as a lane's coefficients, that identical players may differ in."""

    def constants(self) -> Any:
        """Return the numbers, a PyTree of arrays."""
        ...

    def without_constants(self) -> Any:
        """Return the cost as a function of the numbers: hashable, equal where they alone differ.

        It has a method `with_constants(constants)` that makes the cost again.
        """
        ...


def _always(self: PermutationInvariant, i: int, j: int) -> bool:
    """Distinguish all players: the class makes no promise."""
    return True


def distinguishes(part: object, i: int, j: int) -> bool:
    """The same of any cost, constraint or function: those that do not say are taken to."""
    ask = getattr(part, "distinguishes", None)
    return True if ask is None else bool(ask(i, j))
