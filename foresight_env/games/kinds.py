"""Kinds of traffic participants: how they move, how large they are, how fast they get.

Kinds are the class names of the recordings. Every kind that is not listed is a vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Kind(NamedTuple):
    """One kind of traffic participant."""

    vehicle: bool
    """Whether it is steered: its state is `[px, py, v, psi]`. The others move freely in the plane,
    with the state `[px, py, vx, vy]`."""
    length: float
    """Of the body where a recording states none, m."""
    width: float
    """The same across."""
    speed_limit: float
    """Largest velocity, m/s: per axis, of vehicles along the heading."""


CAR = Kind(vehicle=True, length=4.5, width=1.8, speed_limit=20.0)
PEDESTRIAN = Kind(vehicle=False, length=0.5, width=0.5, speed_limit=3.0)
BICYCLE = Kind(vehicle=False, length=1.8, width=0.6, speed_limit=10.0)
KINDS = {"pedestrian": PEDESTRIAN, "bicycle": BICYCLE, "car": CAR}
SIMULATED_CAR = Kind(vehicle=True, length=5.0, width=2.0, speed_limit=30.0)
"""highway-env's vehicle, in the driving scenes."""


MISNAMED = {
    "person": "pedestrian",
    "people": "pedestrian",
    "ped": "pedestrian",
    "walker": "pedestrian",
    "bike": "bicycle",
    "cyclist": "bicycle",
}
"""Other words for kinds that would be taken for vehicles."""


def meant_kind(name: str) -> str | None:
    """Return the kind that another word or spelling stands for; None where `name` is no such word.

    Kinds that are not listed are vehicles, so "Pedestrian" and "ped" would be.
    """
    lower = name.lower()
    return MISNAMED.get(lower, lower if lower != name and lower in KINDS else None)


def check_kinds_of_agents(names: Sequence[str]) -> None:
    """Raise `ValueError` where a name is another word or spelling for a kind that is no vehicle."""
    for i, name in enumerate(names):
        meant = meant_kind(name)
        if meant is not None:
            raise ValueError(
                f'kinds[{i}]: is {name!r}; expected "{meant}", or "pedestrian", "bicycle" or the '
                "name of a vehicle's kind"
            )


def kind_of(name: str) -> Kind:
    """Return the kind of that class name."""
    return KINDS.get(name, CAR)


def is_vehicle(name: str) -> bool:
    """Whether agents of this kind are steered; pedestrians and bicycles are not."""
    return kind_of(name).vehicle


def body_radius(name: str) -> float:
    """Radius (m) of the disc that stands for an agent without a heading."""
    return 0.5 * kind_of(name).width
