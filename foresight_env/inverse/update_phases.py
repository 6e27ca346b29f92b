"""Phases of the moving-horizon estimator, and the transitions between them."""

from __future__ import annotations

from enum import Enum


class UpdatePhase(Enum):
    """Phase of the estimator: how the next update fits."""

    WAITING = "waiting"
    """Too few observations for a fit."""
    SEARCHING = "searching"
    """From the observations, from several starts: there is no usable solution."""
    INITIALISING = "initialising"
    """From the observations, from one start: the window still grows, and with it what is known."""
    TRACKING = "tracking"
    """From the last solution."""
    RELOCATING = "relocating"
    """From the observations, one game: the last fit explains them too little, so that another
    equilibrium may be played, or was not solved."""


class UpdateEvent(Enum):
    """Outcome of an update."""

    NO_DATA = "no data"
    """Fewer than two observations."""
    FITTED_EARLY = "fitted early"
    """A usable fit among the first updates."""
    FITTED = "fitted"
    """A usable fit."""
    DOUBTED = "doubted"
    """A usable fit of a single game that explains the observations too little."""
    KEPT = "kept"
    """Relocating found nothing better than the last solution."""
    MISSED = "missed"
    """The single game of a tracking update was not solved; the last solution remains."""
    FAILED = "failed"
    """No usable fit and no solution to continue from."""


_P, _E = UpdatePhase, UpdateEvent
TRANSITIONS: dict[tuple[UpdatePhase, UpdateEvent], UpdatePhase] = {
    (_P.WAITING, _E.NO_DATA): _P.WAITING,
    (_P.WAITING, _E.FITTED_EARLY): _P.INITIALISING,
    (_P.WAITING, _E.FITTED): _P.TRACKING,
    (_P.WAITING, _E.FAILED): _P.SEARCHING,
    (_P.SEARCHING, _E.FITTED_EARLY): _P.INITIALISING,
    (_P.SEARCHING, _E.FITTED): _P.TRACKING,
    (_P.SEARCHING, _E.FAILED): _P.SEARCHING,
    (_P.INITIALISING, _E.FITTED_EARLY): _P.INITIALISING,
    (_P.INITIALISING, _E.FITTED): _P.TRACKING,
    (_P.INITIALISING, _E.FAILED): _P.SEARCHING,
    (_P.TRACKING, _E.FITTED): _P.TRACKING,
    (_P.TRACKING, _E.DOUBTED): _P.RELOCATING,
    (_P.TRACKING, _E.MISSED): _P.RELOCATING,
    (_P.TRACKING, _E.FAILED): _P.SEARCHING,
    (_P.RELOCATING, _E.FITTED): _P.TRACKING,
    (_P.RELOCATING, _E.KEPT): _P.TRACKING,
    (_P.RELOCATING, _E.FAILED): _P.SEARCHING,
}
"""From the phase of an update and what it ended with to the phase of the next."""
